// The tools of a run on the page of a session: what it would have steered, where it looks, its worst moments.

import { by, make } from "../dom.js";
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
    by("keep-run").addEventListener("click", () => this.keep());
    by("attention").addEventListener("click", () => this.toggleAttention());
    by("worst-next").addEventListener("click", () => this.goToWorst(1));
  }

  /** Choose runs, and keep the lines of all but the last. */
  async choose(runs) {
    for (const run of runs) {
      by("run").value = run;
      await this.predictions.choose(by("run").value);
      if (run !== runs.at(-1)) this.keep();
    }
  }

  /** The log has other rows: what was predicted is of the log as it was. */
  refresh() {
    this.predictions.forgetKept();
    if (this.predictions.run) this.predictions.choose(this.predictions.run);
    else this.curves.build();
  }

  /** Its line stays while other runs are chosen; with none chosen, all that were kept go. */
  keep() {
    if (this.predictions.about) this.predictions.keep();
    else this.predictions.forgetKept();
    this.show();
  }

  /** The prediction of the chosen run, as far as it is there. */
  show() {
    const { predictions, curves } = this;
    const { about, kept } = predictions;
    const run = predictions.problem ? "" : predictions.run; // then it can be chosen again
    by("predicted").textContent = predictions.summary;
    by("predicted").className = predictions.problem ? "problem" : "dim";
    by("run").value = run;
    by("keep-run").disabled = !predictions.canKeep && (about || !kept.length);
    by("keep-run").textContent = about || !kept.length ? "Keep its line" : "Remove kept lines";
    by("kept").replaceChildren(...kept.map(({ column, summary }) => make("span", { className: column }, `${summary} `)));
    for (const { column, name } of kept) curves.names[column] = name;
    curves.names.predicted = kept.length && about ? predictions.name : "predicted";
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
