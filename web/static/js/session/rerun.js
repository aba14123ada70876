// The log in Rerun's viewer, in a frame of the page. It follows the page's moment. The request that opens it stays
// open: when it ends, because the page is closed or Rerun is, so does the process that serves the log.

import { make } from "../dom.js";

export class RerunFrame {
  /** `onProblem(why)`: it could not be opened, or has ended. */
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
    let why = "Rerun has ended; open it again";
    try {
      const answer = await fetch(`${this.data.address}/rerun`, { method: "POST", signal: asking.signal });
      if (!answer.ok) throw new Error((await answer.json()).error);
      for await (const line of lines(answer.body)) {
        const message = JSON.parse(line);
        if (message.problem) why = message.problem;
        else if (message.note) this.status.textContent = message.note;
        else this.show(message);
      }
    } catch (error) {
      why = error instanceof TypeError ? "bc-web does not answer: it was ended, or is restarted" : error.message;
    }
    if (this.asking !== asking) return; // closed here
    this.close();
    this.onProblem(why);
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
      this.frame.blur(); // it takes the keys when it starts; they are the page's until the user clicks into it
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
