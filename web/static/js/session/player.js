// Playing at the speed of the recording: at each frame of the screen, the row whose moment has come.

const LONGEST_GAP_S = 1; // what was paused for longer is not waited for

export class Player {
  constructor(data, { onMove, onChange }) {
    Object.assign(this, { data, onMove, onChange });
    this.isPlaying = false;
    this.speed = 1;
  }

  useRows() {
    const times = this.data.columns.time_s;
    this.times = new Float64Array(this.data.length);
    for (let at = 1; at < this.data.length; at += 1) {
      this.times[at] = this.times[at - 1] + Math.min(Math.max(times[at] - times[at - 1], 0), LONGEST_GAP_S);
    }
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
    this.time = this.times[position];
    let before = performance.now();
    const step = (now) => {
      if (!this.isPlaying) return;
      this.time += (Math.max(now - before, 0) / 1000) * this.speed;
      before = now;
      let at = this.at;
      while (at + 1 < this.data.length && this.times[at + 1] <= this.time) at += 1;
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
