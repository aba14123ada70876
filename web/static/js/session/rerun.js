// The log in Rerun's viewer, in a frame of the page. It follows the page's moment. The request that opens it stays
// open: when it ends, because the page is closed or Rerun is, so does the process that serves the log.

export class RerunFrame {
  /** `onProblem(why)`: it could not be opened, or has ended. */
  constructor(section, data, { onChange, onProblem }) {
    Object.assign(this, { section, data, onChange, onProblem });
    this.told = section.querySelector("[role=status]");
    this.asking = null;
    this.frame = null;
    this.isReady = false;
    this.position = 0;
    addEventListener("message", (event) => this.heard(event));
  }

  get isOpen() {
    return this.asking !== null;
  }

  async open(position) {
    const asking = (this.asking = new AbortController());
    this.position = position;
    this.section.hidden = false;
    this.told.textContent = "Rerun starts";
    this.onChange();
    let why = "Rerun has ended; open it again";
    try {
      const answer = await fetch(`${this.data.address}/rerun`, { method: "POST", signal: asking.signal });
      if (!answer.ok) throw new Error((await answer.json()).error);
      for await (const line of lines(answer.body)) {
        const said = JSON.parse(line);
        if (said.problem) why = said.problem;
        else if (said.note) this.told.textContent = said.note;
        else this.show(said);
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
    this.told.textContent = "";
    this.frame = document.createElement("iframe");
    this.frame.title = "Rerun";
    this.frame.src = frame;
    this.section.append(this.frame);
  }

  moveTo(position) {
    this.position = position;
    if (!this.isReady || this.isGrowing || !this.data.length) return;
    const at = this.data.columns.time_s[position] + this.lateS; // Rerun counts from the log's first message
    this.frame.contentWindow.postMessage({ at_s: at }, location.origin);
  }

  heard({ source, origin, data }) {
    if (!this.frame || source !== this.frame.contentWindow || origin !== location.origin) return;
    if (data.is_ready) {
      this.isReady = true;
      this.frame.blur(); // it takes the keys when it starts; they are the page's until somebody clicks into it
      this.moveTo(this.position);
    }
    if (data.problem) this.onProblem(data.problem);
    if (data.shown_s !== undefined) this.section.dataset.shown = data.shown_s; // for whoever waits for it
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
