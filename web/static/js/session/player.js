// Playing a log: at each frame of the screen, it shows the row of that moment.

export class Player {
  constructor(data, { onMove, onChange }) {
    Object.assign(this, { data, onMove, onChange });
    this.isPlaying = false;
    this.speed = 1;
  }

  toggle(position) {
    if (!this.data.length) return;
    if (this.isPlaying) this.pause();
    else this.play(position >= this.data.length - 1 ? 0 : position);
  }

  play(position) {
    this.isPlaying = true;
    this.onChange();
    this.at = position;
    this.time = this.data.columns.driven_s[position];
    let before = performance.now();
    const step = (now) => {
      if (!this.isPlaying) return;
      this.time += (Math.max(now - before, 0) / 1000) * this.speed;
      before = now;
      let at = this.at;
      const { driven_s } = this.data.columns; // without pauses
      while (at + 1 < this.data.length && driven_s[at + 1] <= this.time) at += 1;
      if (at !== this.at) this.onMove((this.at = at));
      if (at >= this.data.length - 1) this.pause();
      else requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  pause() {
    this.isPlaying = false;
    this.onChange();
  }
}
