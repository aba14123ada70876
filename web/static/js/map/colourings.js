// The colourings of a map. Each puts every point into one of a few buckets, which the legend lists.

import { angle, colourReader } from "../dom.js";
import { EXCLUDE, FINE } from "../tag_changes.js";

const SERIES = [0, 1, 2, 3, 4, 5, 6].map((number) => `--series-${number}`);
const STEPS = [0, 1, 2, 3, 4, 5].map((number) => `--step-${number}`);
const STEERING = [-0.5, -0.25, -0.1, -0.03, 0.03, 0.1, 0.25, 0.5];
const ERRORS = [0.02, 0.05, 0.1, 0.2, 0.4];
const ALONE = [0.5, 1, 1.5, 2, 3];

const edges = (values, text) => [
  `below ${text(values[0])}`,
  ...values.slice(1).map((value, at) => `${text(values[at])} to ${text(value)}`),
  `${text(values.at(-1))} and more`,
];
const bucket = (values, value) => values.findIndex((edge) => value < edge) >>> 0;

/** The colourings of a map: {name: () => ({names, colours, buckets})}. `buckets` has the bucket of each point. */
export function colouringsOf(map) {
  const { columns, logs, about, length } = map;
  const filled = (bucketOf) => Uint8Array.from({ length }, (_, at) => bucketOf(at));
  const numbers = (values, names, colours, valueOf) => ({
    names: [...names, "unknown"],
    colours: [...colours, "--dim"],
    buckets: filled((at) => {
      const value = valueOf(at);
      return Number.isFinite(value) ? Math.min(bucket(values, value), values.length) : names.length;
    }),
  });
  const deg = (share) => angle(share, about.max_deg, about.max_deg === null ? 0 : 1);
  const colourings = {
    steering: () =>
      numbers(
        STEERING,
        ["far left", "left", "a bit left", "slightly left", "straight on", "slightly right", "a bit right", "right", "far right"],
        [4, 3, 2, 1, 0, 1, 2, 3, 4].map((step, at) => (step ? `--${at < 4 ? "left" : "right"}-${step}` : "--straight")),
        (at) => columns.steering[at],
      ),
    session: () => ({
      names: [...logs.slice(0, SERIES.length).map(({ name }) => name), ...(logs.length > SERIES.length ? ["others"] : [])],
      colours: [...SERIES.slice(0, logs.length), "--series-7"],
      buckets: filled((at) => Math.min(columns.log[at], SERIES.length)),
    }),
    flag: () => {
      const kinds = about.odd.filter((_, kind) => columns.odd.includes(kind));
      const names = ["nothing odd", "excluded", "fine", "another tag", ...kinds.map((kind) => kind.replaceAll("_", " "))];
      const colours = ["--dim", "--bad", "--good", "--tag", ...kinds.map((_, at) => SERIES[(at + 1) % SERIES.length])];
      return {
        names,
        colours,
        buckets: filled((at) => {
          const tags = map.tagsOf(at);
          if (tags.includes(EXCLUDE)) return 1;
          if (tags.includes(FINE)) return 2;
          if (columns.odd[at] >= 0) return 4 + kinds.indexOf(about.odd[columns.odd[at]]);
          return tags.length ? 3 : 0;
        }),
      };
    },
    "how alone it is": () =>
      numbers(ALONE, edges(ALONE, (value) => `${value}x`), STEPS, (at) => columns.alone[at]),
  };
  if (columns.predicted.some(Number.isFinite)) {
    colourings.error = () =>
      numbers(ERRORS, edges(ERRORS, deg), STEPS, (at) => Math.abs(columns.predicted[at] - columns.steering[at]));
  }
  return colourings;
}

export const paletteOf = (colouring, element) => colouring.colours.map(colourReader(element));
