// The tools of a run on the page of a session: predicted steering, where the network looks, worst moments.

import { by } from "../dom.js";
import { showStatus } from "../live.js";
import { Attention } from "./attention.js";
import { listWorst } from "./lists.js";
import { Predictions } from "./predictions.js";

export class RunTools {
  /** `onPick(position)`: a worst moment was chosen. `onChange()`: the columns of the data have changed. */
  constructor(page, data, curves, { onPick, onChange }) {
    Object.assign(this, { page, curves, onPick, onChange });
    this.predictions = new Predictions(data, { onChange: () => this.show() });
    this.attention = new Attention(document.querySelector("figure[data-camera=center]"), data, {
      onChange: (problem) => {
        by("attention").setAttribute("aria-pressed", this.attention.isOn);
        if (problem) showStatus(problem);
      },
    });
    by("run").addEventListener("change", () => {
      this.predictions.choose(by("run").value);
      by("run").blur(); // keys are for the page again
    });
    by("predict-stop").addEventListener("click", () =>
      this.predictions.stop().then(
        () => showStatus("stopped"),
        (error) => showStatus(error.message),
      ),
    );
    by("attention").addEventListener("click", () => this.toggleAttention());
    by("worst-next").addEventListener("click", () => this.goToWorst(1));
  }

  choose(run) {
    by("run").value = run;
    this.predictions.choose(by("run").value); // "" if there is no such run
  }

  /** The rows have changed: predict anew. */
  refresh() {
    if (this.predictions.run) this.predictions.choose(this.predictions.run);
    else this.curves.build();
  }

  show() {
    const { predictions } = this;
    const { about } = predictions;
    const run = predictions.problem ? "" : predictions.run; // after a problem, the run can be chosen again
    by("predicted").textContent = predictions.summary;
    by("predicted").className = predictions.problem ? "problem" : "dim";
    by("run").value = run;
    by("predict-stop").hidden = !predictions.isWaiting;
    this.attention.use(run);
    by("attention").disabled = !run;
    by("worst-next").disabled = !predictions.worst.length;
    by("worst-part").hidden = !about;
    listWorst(by("worst"), predictions.worst, (moment) => this.onPick(moment.position));
    this.onChange();
    this.page.dataset.run = about ? predictions.run : ""; // for scripts that wait for it
  }

  toggleAttention() {
    if (this.predictions.run) this.attention.toggle();
    else showStatus("choose a network first");
  }

  goToWorst(step) {
    const { predictions } = this;
    const moment = predictions.next(step);
    if (!moment) return showStatus(predictions.about ? "the log has no steering to compare with" : "choose a network first");
    this.onPick(moment.position);
    showStatus(`${predictions.at + 1} of ${predictions.worst.length}: ${moment.words}`);
  }
}
