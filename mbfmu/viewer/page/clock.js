/* The clock of the page: never before the first recorded frame nor after the last. */

const SPEEDS = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 1000];
const LONGEST = 0.1; // s of the reader's time that one picture may take: a page in the background does not jump

class Clock {
  /** `times` of the recorded frames, s. */
  constructor(times) {
    this.times = times;
    this.start = times[0];
    this.end = times[times.length - 1];
    this.time = this.start;
    this.playing = false;
    this.loop = true;
    this.speed = this.fittingSpeed();
    this.last = null;
  }

  /** Real time, unless the motion would be over in a moment or last for minutes. */
  fittingSpeed() {
    const span = this.end - this.start;
    if (span >= 2 && span <= 120) {
      return 1;
    }
    return SPEEDS.findLast((speed) => span / speed >= 5) ?? SPEEDS[0];
  }

  /** A moment `now` (ms) of the reader's time is there, which may lie before the last one. */
  tick(now) {
    const passed = Math.min(Math.max((now - (this.last ?? now)) / 1000, 0), LONGEST);
    this.last = now;
    if (!this.playing) {
      return;
    }
    this.goTo(this.time + passed * this.speed);
    if (this.time >= this.end) {
      this.playing = this.loop;
      this.time = this.loop ? this.start : this.end;
    }
  }

  goTo(time) {
    this.time = Math.min(Math.max(time, this.start), this.end);
  }

  /** Stop at a time. */
  halt(time) {
    this.playing = false;
    this.goTo(time);
  }

  toggle() {
    this.playing = !this.playing;
    if (this.playing && this.time >= this.end) {
      this.time = this.start;
    }
  }

  /** To the next or the last recorded frame. */
  step(by) {
    const k = frameAt(this.times, this.time);
    const back = by < 0 && this.time > this.times[k] ? 0 : by;
    this.halt(this.times[Math.min(Math.max(k + back, 0), this.times.length - 1)]);
  }

  changeSpeed(by) {
    const k = SPEEDS.indexOf(this.speed) + by;
    this.speed = SPEEDS[Math.min(Math.max(k, 0), SPEEDS.length - 1)];
  }
}
