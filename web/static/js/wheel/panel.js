// The data of a frame besides its picture: numbers, the steering wheel, the map, who drives.

import { by, number } from "../dom.js";
import { RoadMap } from "../road_map.js";

const WHEEL_DEG = 135; // of the steering wheel at full lock
const SLOW_PACE = 0.97;

/** Write a text if it has changed: screen readers read every new text, and the browser lays it out. */
export function write(id, text) {
  if (by(id).textContent !== String(text)) by(id).textContent = text;
}

export class Panel {
  #map = new RoadMap(by("map"));
  #hello = {};

  /** Show the data that stay the same for the whole drive. */
  greet(hello) {
    this.#hello = hello;
    this.#map.show(hello.road ?? null);
    for (const element of document.querySelectorAll(".of-network")) element.hidden = hello.kind !== "drive";
    const isBuiltIn = Boolean(hello.track); // other simulators put their car back themselves, and have one picture
    for (const id of ["laps", "put-back"]) by(id).parentElement.hidden = !isBuiltIn;
    for (const id of ["put-back-button", "recorded"]) by(id).hidden = !isBuiltIn;
    by("record").hidden = hello.kind === "drive"; // a drive is recorded as a whole
  }

  /** Show a frame. `isHolder`: this page has the wheel. `delay_ms` was measured in this page. */
  show(frame, isHolder, delay_ms) {
    write("speed", (frame.speed_mph ?? 0).toFixed(1));
    write("rows", `${number(frame.rows)} rows`);
    write("time", clock(frame.recorded_s ?? frame.time_s));
    write("sent", side(frame.steering ?? 0));
    write("pedals", pedal(frame.throttle));
    const wanted = frame.predicted == null ? null : Math.min(Math.max(frame.predicted, -1), 1); // as it would be sent
    write("predicted", wanted === null ? "-" : side(wanted));
    write("takeovers", String(frame.takeovers ?? 0));
    write("laps", frame.laps == null ? "-" : frame.laps.toFixed(2));
    write("put-back", String(frame.put_back ?? 0));
    const wished_hz = this.#hello.picture_hz ? ` of ${this.#hello.picture_hz.toFixed(0)}` : "";
    write("rate", `${(frame.picture_hz ?? 0).toFixed(0)}${wished_hz} a second`);
    write("pace", pace(frame.pace));
    by("pace").classList.toggle("odd", frame.pace != null && frame.pace < SLOW_PACE);
    write("delay", delay_ms == null ? "-" : `${delay_ms.toFixed(0)} ms`);
    const isWaiting = frame.stalled || (this.#hello.kind !== "drive" && ["brake", "nobody"].includes(frame.drives));
    const waits = frame.stalled ? "no new rows" : "nobody steers: no new rows";
    this.showRecording(frame.is_recording ? (isWaiting ? waits : "recording") : frame.rows ? "paused" : "not recording yet");
    write("record-label", frame.is_recording ? "Pause" : "Record");
    write("driver", this.#driver(frame, isHolder));
    by("driver").dataset.by = frame.drives;
    by("in-force").setAttribute("transform", `rotate(${(frame.steering ?? 0) * WHEEL_DEG})`);
    by("wanted").setAttribute("visibility", wanted === null ? "hidden" : "visible");
    by("wanted").setAttribute("transform", `rotate(${(wanted ?? 0) * WHEEL_DEG})`);
    this.#map.move(frame);
  }

  /** Only "recording" is lit: rows are written now. */
  showRecording(text) {
    write("recording", text);
    by("recording").classList.toggle("on", text === "recording");
  }

  #driver({ drives, device }, isHolder) {
    const person = `${isHolder ? "you drive" : "a person drives"}${device ? `: ${device}` : ""}`;
    const words = {
      human: person,
      pilot: `the network drives${this.#hello.run ? `: ${this.#hello.run}` : ""}`,
      expert: "the expert drives",
      brake: "nobody is at the wheel: the car is braked",
      nobody: "nobody drives",
    };
    return words[drives] ?? "";
  }
}

function side(steering) {
  const amount = Math.abs(steering).toFixed(2);
  return amount === "0.00" ? "straight" : `${amount} ${steering < 0 ? "left" : "right"}`;
}

function pedal(throttle) {
  const percent = Math.round(100 * Math.abs(throttle ?? 0));
  return percent ? `${throttle < 0 ? "brake" : "throttle"} ${percent} %` : "rolling";
}

function pace(value) {
  if (value == null) return "-";
  return value < SLOW_PACE ? `${Math.floor(100 * value)} % of real time` : "real time";
}

function clock(seconds) {
  const whole = Math.floor(seconds ?? 0);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}
