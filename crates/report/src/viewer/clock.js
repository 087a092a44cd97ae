// The time in the motion. While a song plays, the time follows the song.

class Clock {
  constructor(seconds, song) {
    Object.assign(this, { seconds, time: 0, playing: false, loop: true, rate: 1, last: null });
    if (!song) return;
    this.start = song.start;
    this.audio = new Audio();
    this.audio.preload = "auto";
    this.audio.src = song.src;
    this.audio.preservesPitch = true;
  }

  // True if the song is audible at this time.
  sounds() {
    const at = this.time + this.start;
    const end = this.audio?.duration;
    return Boolean(this.audio) && at >= 0 && !(at >= end) && !this.silent;
  }

  play() {
    if (this.playing) return;
    if (this.time >= this.seconds - 1e-6) this.seek(0);
    this.playing = true;
    this.last = null;
    this.sing();
  }

  // Starts the song at the time of the motion. It stays silent if the browser does not allow it.
  async sing() {
    if (!this.sounds() || this.starting) return;
    this.starting = true;
    this.place();
    this.audio.playbackRate = this.rate;
    try {
      await this.audio.play();
    } catch (refused) {
      if (refused.name !== "AbortError") this.silent = true;
    }
    this.starting = false;
    if (!this.playing) this.audio.pause();
  }

  pause() {
    this.playing = false;
    this.audio?.pause();
  }

  // Sets the song to the time of the motion.
  place() {
    const at = Math.max(0, this.time + this.start);
    if (Math.abs(this.audio.currentTime - at) > 1e-3) this.audio.currentTime = at;
  }

  seek(time) {
    this.time = Math.min(this.seconds, Math.max(0, time));
    this.last = null;
    if (!this.audio) return;
    if (this.sounds()) this.place();
    else this.audio.pause();
  }

  setRate(rate) {
    this.rate = rate;
    if (this.audio) this.audio.playbackRate = rate;
  }

  // Moves on to the moment `now` (milliseconds) of the screen.
  tick(now) {
    if (!this.playing) return;
    const passed = this.last === null ? 0 : (now - this.last) / 1000;
    this.last = now;
    if (this.audio && !this.audio.paused && !this.audio.ended && !this.starting) {
      this.time = this.audio.currentTime - this.start;
    } else if (!this.starting) {
      this.time += passed * this.rate;
      if (this.sounds()) this.sing();
    }
    if (this.time < this.seconds) return;
    if (this.loop) {
      this.seek(0);
    } else {
      this.time = this.seconds;
      this.pause();
    }
  }
}
