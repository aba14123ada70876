// The log in Rerun's viewer, in a frame of the page. It follows the page's moment. The request that opens it stays
// open. The process that serves the log ends with this request.

import { make } from "../dom.js";
import { NO_ANSWER } from "../live.js";

export class RerunFrame {
  /** `onProblem(reason)`: it could not be opened, or has ended. */
  constructor(section, data, { onChange, onProblem }) {
    Object.assign(this, { section, data, onChange, onProblem });
    this.status = section.querySelector("[role=status]");
    this.asking = null;
    this.frame = null;
    this.isReady = false;
    this.position = 0;
    addEventListener("message", (event) => this.onMessage(event));
  }

  get isOpen() {
    return this.asking !== null;
  }

  async open(position) {
    const asking = (this.asking = new AbortController());
    this.position = position;
    this.section.hidden = false;
    this.status.textContent = "Rerun starts";
    this.onChange();
    let reason = "Rerun has ended; open it again";
    try {
      const answer = await fetch(`${this.data.address}/rerun`, { method: "POST", signal: asking.signal });
      if (!answer.ok) throw new Error((await answer.json()).error);
      for await (const line of lines(answer.body)) {
        const message = JSON.parse(line);
        if (message.problem) reason = message.problem;
        else if (message.note) this.status.textContent = message.note;
        else this.show(message);
      }
    } catch (error) {
      reason = error instanceof TypeError ? NO_ANSWER : error.message;
    }
    if (this.asking !== asking) return; // closed here
    this.close();
    this.onProblem(reason);
  }

  close() {
    this.asking?.abort();
    this.asking = null;
    this.frame?.remove();
    this.frame = null;
    this.isReady = false;
    this.section.hidden = true;
    delete this.section.dataset.shown;
    this.onChange();
  }

  show({ frame, late_s: lateS, is_growing: isGrowing }) {
    this.lateS = lateS;
    this.isGrowing = isGrowing; // then Rerun follows the recording, not the page
    this.status.textContent = "";
    this.frame = this.section.appendChild(make("iframe", { title: "Rerun", src: frame }));
  }

  moveTo(position) {
    this.position = position;
    if (!this.isReady || this.isGrowing || !this.data.length) return;
    const at = this.data.columns.time_s[position] + this.lateS; // Rerun counts from the log's first message
    this.frame.contentWindow.postMessage({ at_s: at }, location.origin);
  }

  onMessage({ source, origin, data }) {
    if (!this.frame || source !== this.frame.contentWindow || origin !== location.origin) return;
    if (data.is_ready) {
      this.isReady = true;
      this.frame.blur(); // Rerun takes the focus when it starts; the page's keys go on until the user clicks into it
      this.moveTo(this.position);
    }
    if (data.problem) this.onProblem(data.problem);
    if (data.shown_s !== undefined) this.section.dataset.shown = data.shown_s; // for scripts that wait for it
  }
}

async function* lines(body) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    text += value;
    const whole = text.split("\n");
    text = whole.pop();
    yield* whole;
  }
}
