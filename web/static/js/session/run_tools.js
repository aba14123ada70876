// The tools of a run on the page of a session: what it would have steered, where it looks, its worst moments.

import { by } from "../dom.js";
import { showStatus } from "../live.js";
import { Attention } from "./attention.js";
import { listWorst } from "./lists.js";
import { Predictions } from "./predictions.js";

export class RunTools {
  /** `onPick(position)`: a worst moment was chosen; `onChange()`: the columns of the data are other ones. */
  constructor(page, data, curves, { onPick, onChange }) {
    Object.assign(this, { page, curves, onPick, onChange });
    this.predictions = new Predictions(data, { onChange: () => this.show() });
    this.attention = new Attention(document.querySelector("figure[data-camera=center]"), data, {
      onChange: (why) => {
        by("attention").setAttribute("aria-pressed", this.attention.isOn);
        if (why) showStatus(why);
      },
    });
    by("run").addEventListener("change", () => {
      this.predictions.choose(by("run").value);
      by("run").blur(); // its keys are the page's again
    });
    by("predict-stop").addEventListener("click", () =>
      this.predictions.stop().then(
        () => showStatus("stopped: the network looks at no more pictures"),
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

  /** The log has other rows: the predictions are of the log as it was. */
  refresh() {
    if (this.predictions.run) this.predictions.choose(this.predictions.run);
    else this.curves.build();
  }

  /** The prediction of the chosen run, as far as it is there. */
  show() {
    const { predictions } = this;
    const { about } = predictions;
    const run = predictions.problem ? "" : predictions.run; // then it can be chosen again
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
    this.page.dataset.run = about ? predictions.run : ""; // what is shown now, for scripts that wait for it
  }

  toggleAttention() {
    if (this.predictions.run) this.attention.toggle();
    else showStatus("choose a run first, whose network looks at this picture");
  }

  goToWorst(step) {
    const { predictions } = this;
    const moment = predictions.next(step);
    if (!moment) return showStatus(predictions.about ? "nothing was recorded to compare with" : "choose a run first, whose network looks at this log");
    this.onPick(moment.position);
    showStatus(`${predictions.at + 1} of ${predictions.worst.length}: ${moment.words}`);
  }
}
