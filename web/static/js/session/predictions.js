// The predictions of the chosen run's network: progress, then a column of the data and a list of worst moments.

import { clock } from "../dom.js";
import { ask, awaited } from "./log_data.js";

export class Predictions {
  /** `onChange()`: another run, progress, or the result. */
  constructor(data, { onChange }) {
    Object.assign(this, { data, onChange });
    this.clear("");
  }

  clear(run) {
    Object.assign(this, { run, summary: "", problem: "", about: null, worst: [], at: -1, making: {} });
    delete this.data.columns.predicted;
  }

  get isWaiting() {
    return Boolean(this.run) && !this.about && !this.problem;
  }

  /** Stop the work. Then no run is chosen. */
  async stop() {
    if (!this.isWaiting) return;
    const { run } = this;
    this.clear("");
    this.onChange();
    await ask(this.address(`${run}/stop`), { method: "POST" });
  }

  async choose(run) {
    this.clear(run);
    this.onChange();
    if (!run) return;
    const { making } = this;
    const isWanted = () => this.making === making; // else another one was begun, or it was stopped
    try {
      const state = await awaited(this.address(run), {
        isWanted,
        onProgress: (progress) => {
          this.summary = waiting(progress);
          this.onChange();
        },
      });
      if (!isWanted()) return;
      const column = await ask(`${this.data.address}/predictions/rows/${state.key}`);
      const predicted = new Float64Array(await column.arrayBuffer());
      if (!isWanted()) return;
      if (predicted.length !== this.data.length) throw new Error("the log has changed: choose the network again");
      this.data.columns.predicted = predicted;
      this.show(state);
    } catch (error) {
      if (!isWanted()) return;
      this.summary = this.problem = error.message;
    }
    this.onChange();
  }

  address(path) {
    return `${this.data.address}/predictions/${path}?log=${this.data.state.fingerprint}`;
  }

  show({ name, about }) {
    this.about = about;
    // if the angle is unknown: in shares of full lock, which counts as 25 degrees
    const angle = (degrees, digits) =>
      about.max_deg === null ? `${(degrees * 4).toFixed(digits)} % of full lock` : `${degrees.toFixed(digits)}°`;
    const compared =
      about.rmse_deg === null
        ? "the log has no steering to compare with"
        : `RMSE ${angle(about.rmse_deg, 2)}; always predicting the mean: ${angle(about.mean_rmse_deg, 2)}`;
    this.summary = [`${name}: ${about.frames.toLocaleString("en")} frames`, compared, ...about.notes].join(", ");
    this.worst = about.worst.map((moment) => {
      const position = this.data.position(moment.row, false);
      const side = moment.error_deg > 0 ? "right" : "left";
      return {
        position,
        short: `${angle(Math.abs(moment.error_deg), 1)} too far ${side}`,
        words:
          `row ${moment.row}, at ${clock(this.data.columns.driven_s[position])}: ` +
          `${angle(moment.predicted_deg, 1)} predicted, ${angle(moment.recorded_deg, 1)} recorded`,
      };
    });
  }

  /** The next worst moment, or the one before (`step` -1). */
  next(step) {
    if (!this.worst.length) return null;
    this.at = (Math.max(this.at, step > 0 ? -1 : 0) + step + this.worst.length) % this.worst.length;
    return this.worst[this.at];
  }
}

function waiting({ is_begun: isBegun, pictures, total, left_s: leftS }) {
  if (isBegun === false) return "waiting for another prediction";
  if (!pictures) return "loading the network";
  const left = leftS === null ? "" : `, ${clock(leftS)} left`;
  return `${pictures.toLocaleString("en")} of ${total.toLocaleString("en")} pictures${left}`;
}
