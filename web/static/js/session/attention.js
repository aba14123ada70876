// Where the chosen run's network looks, over the centre camera's picture. As with pictures, one is asked for at a
// time, and then the newest that is wanted.

import { ask } from "./log_data.js";

export class Attention {
  /** `onChange(why)`: it is shown or not any more; `why` tells what went wrong. */
  constructor(figure, data, { onChange }) {
    Object.assign(this, { figure, data, onChange });
    this.image = figure?.appendChild(Object.assign(new Image(), { className: "attention", hidden: true }));
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
    this.isOn = Boolean(this.image) && Boolean(this.run) && !this.isOn;
    if (this.isOn) this.show(this.position);
    else this.hide();
    this.onChange("");
  }

  hide() {
    if (!this.image) return;
    this.image.hidden = true;
    URL.revokeObjectURL(this.image.src);
    this.image.removeAttribute("src");
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
        const shown = URL.createObjectURL(await answer.blob());
        const before = this.image.src;
        this.image.src = shown;
        await this.image.decode();
        URL.revokeObjectURL(before);
        this.image.alt = "where the network looks";
        this.image.hidden = !this.isOn;
        this.figure.dataset.attention = address; // for whoever waits for it
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
