// The attention map of the chosen run's network, over the centre camera's picture. One map is fetched at a time, then
// the newest wanted one.

import { make } from "../dom.js";
import { ask } from "./log_data.js";

export class Attention {
  /** `onChange(problem)`: it was switched on or off; `problem` may be "". */
  constructor(figure, data, { onChange }) {
    Object.assign(this, { figure, data, onChange });
    this.image = null; // over the picture, while it is shown
    this.run = "";
    this.isOn = false;
    this.position = 0;
    this.isAsking = false;
  }

  /** Another run was chosen; empty for none. */
  use(run) {
    if (run === this.run) return;
    this.run = run;
    if (this.isOn && !run) this.toggle();
    else this.show(this.position);
  }

  toggle() {
    this.isOn = Boolean(this.figure) && Boolean(this.run) && !this.isOn;
    if (this.isOn) this.show(this.position);
    else this.hide();
    this.onChange("");
  }

  hide() {
    if (!this.image) return;
    URL.revokeObjectURL(this.image.src);
    this.image.remove();
    this.image = null;
    delete this.figure.dataset.attention;
  }

  async show(position) {
    this.position = position;
    if (!this.isOn || this.isAsking || !this.data.length) return;
    this.isAsking = true;
    let address = "";
    try {
      while (this.isOn && address !== this.wanted()) {
        address = this.wanted();
        const answer = await ask(address);
        const next = make("img", { className: "attention", alt: "where the network looks" });
        next.src = URL.createObjectURL(await answer.blob());
        await next.decode();
        this.hide();
        this.image = this.figure.appendChild(next);
        this.figure.dataset.attention = address; // for scripts that wait for it
      }
    } catch (error) {
      this.isOn = false;
      this.hide();
      this.onChange(error.message);
    }
    this.isAsking = false;
    if (!this.isOn) this.hide();
  }

  wanted() {
    const row = this.data.columns.row[this.position];
    return `${this.data.address}/attention/${this.run}/${row}?v=${this.data.state.version}`;
  }
}
