// The forms that make new logs of this one: their commands are shown once they are opened, and trimming keeps the
// selected rows.

export class Makers {
  constructor(details, data) {
    Object.assign(this, { details, data });
    details.addEventListener("toggle", () => details.open && this.show());
  }

  select(rows) {
    const all = this.data.length ? [0, this.data.length - 1].map((at) => this.data.columns.row[at]) : ["", ""];
    const trim = this.details.querySelector("#make-trim");
    for (const [at, name] of ["first", "last"].entries()) trim.elements[name].value = (rows ?? all)[at];
    if (this.details.open) trim.dispatchEvent(new Event("show"));
  }

  show() {
    for (const form of this.details.querySelectorAll("form")) form.dispatchEvent(new Event("show"));
  }
}
