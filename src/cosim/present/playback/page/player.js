"use strict";
/* The page: time, buttons and keys; what is seen follows from the runs and the present time. */
const $ = (name) => document.getElementById(name);

function saved(content, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

class Player {
  constructor(data, results) {
    this.data = data;
    this.speed = data.speed;
    this.playing = !window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    document.body.classList.toggle("flat", data.flat);
    this.scene = new Scene(data, $("view"));
    this.curves = new Curves(data, $("charts"), $("choice").querySelector("div"), (t) => this.go(t));
    for (const speed of [...new Set([0.05, 0.1, 0.2, 0.5, 1, 2, 5, data.speed])].sort((a, b) => a - b))
      $("speed").add(new Option(`${speed} x`, speed, speed === data.speed, speed === data.speed));
    $("speed").addEventListener("change", (e) => (this.speed = Number(e.target.value)));
    this.t = results[0].time[0];
    this.take(results);
    this.listen();
    this.resize();
    this.last = performance.now();
    requestAnimationFrame((now) => this.frame(now));
  }

  /* Shows why there is no run; what the last run drew stays, faint. */
  fail(reason) {
    this.failure = reason;
    document.body.classList.toggle("failed", Boolean(reason));
    this.stale = true;
  }

  take(results) {
    this.fail("");
    this.results = results;
    results.forEach((run, i) => run.time.length && this.scene.actors[i].take(run));
    if (this.data.live && this.scene.fitted) this.scene.fit();
    const { time } = results[0];
    [this.begin, this.end] = [time[0], time[time.length - 1]];
    this.t = Math.min(Math.max(this.t, this.begin), this.end);
    const span = this.end - this.begin;
    this.decimals = span < 1 ? 3 + Math.ceil(-Math.log10(span || Math.abs(this.end) || 1)) : 2;
    Object.assign($("time"), { min: this.begin, max: this.end });
    this.curves.take(results);
    this.stale = true;
  }

  go(t) {
    this.playing = false;
    this.t = Math.min(Math.max(t, this.begin), this.end);
    this.stale = true;
  }

  step(count) {
    const { time } = this.results[0], [i, j, s] = station(time, this.t);
    const next = count > 0 ? (s < 1 ? j : j + 1) : s > 0 ? i : i - 1;
    this.go(time[Math.min(Math.max(next, 0), time.length - 1)]);
  }

  listen() {
    const pressed = (button, on) => button.setAttribute("aria-pressed", on);
    const toggle = (button, act) => button.addEventListener("click", () => {
      const on = button.getAttribute("aria-pressed") !== "true";
      pressed(button, on);
      act(on);
      this.stale = true;
    });
    $("play").addEventListener("click", () => (this.playing = !this.playing));
    $("back").addEventListener("click", () => this.step(-1));
    $("forth").addEventListener("click", () => this.step(1));
    $("time").addEventListener("input", (e) => this.go(e.target.valueAsNumber));
    $("fit").addEventListener("click", () => { this.scene.fit(); this.stale = true; });
    toggle($("axes"), (on) => this.scene.axes(on));
    $("beside").hidden = this.results.length < 2;
    toggle($("beside"), (on) => this.scene.beside(on));
    $("picture").addEventListener("click", () =>
      this.scene.canvas.toBlob((content) => saved(content, `${document.title}.png`)));
    const keys = {
      " ": () => (this.playing = !this.playing), ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1),
      Home: () => this.go(this.begin), End: () => this.go(this.end), "+": () => this.scene.zoom(0.9),
      "-": () => this.scene.zoom(1.1), r: () => this.scene.fit(), a: () => $("axes").click(),
    };
    document.addEventListener("keydown", (e) => {
      if (e.ctrlKey || e.metaKey || e.altKey || e.target.matches("input:not([type=checkbox]), select")) return;
      if (e.key === " " && e.target.matches("input, button, summary")) return; // it is pressed
      if (!keys[e.key]) return;
      e.preventDefault();
      keys[e.key]();
      this.stale = true;
    });
    const { canvas } = this.scene;
    for (const name of ["pointermove", "wheel", "pointerdown"])
      canvas.addEventListener(name, (e) => { this.stale = true; this.point(e); });
    canvas.addEventListener("pointerleave", () => ($("hover").hidden = true));
    new ResizeObserver(() => this.resize()).observe($("view"));
    DARK.addEventListener("change", () => {
      this.scene.paint();
      this.curves.build();
      this.stale = true;
    });
  }

  point(event) {
    const text = event.buttons ? "" : this.scene.at(event.clientX, event.clientY), box = $("hover");
    box.hidden = !text;
    box.textContent = text;
    const place = $("view").getBoundingClientRect();
    box.style.left = `${event.clientX - place.left + 14}px`;
    box.style.top = `${event.clientY - place.top + 10}px`;
  }

  resize() {
    this.scene.resize();
    this.curves.resize();
    this.scene.draw(this.t); // now, as an observer is called after the frame: another size is black
  }

  facts() {
    const parts = [this.data.title];
    if (this.failure) {
      $("facts").textContent = parts[0];
      this.alarm([`no run: ${this.failure}`]);
      return;
    }
    for (const k of this.data.labels) {
      const { name, factor, offset, unit } = this.data.columns[k], { time, values } = this.results[0].curves;
      const value = sampled(time, values[k], [this.t])[0] * factor + offset;
      parts.push(`${name} = ${shown(value)} ${unit}`);
    }
    $("facts").textContent = parts.join("\n");
    this.alarm(this.results.flatMap((run) => this.complaints(run)));
    const now = this.t + 1e-6 * (this.end - this.begin); // times of frames are rounded
    const { events } = this.results[0], last = events.filter(([time]) => time <= now).pop();
    if (last && this.t - last[0] < 0.5 * this.speed)
      $("facts").appendChild(document.createElement("div")).textContent =
        events.filter(([time]) => time === last[0]).map(([, name]) => name).join(", ");
  }

  /* What is wrong with a run, at all times: a line that comes and goes would move the picture. */
  complaints(run) {
    const since = run.invalid_from, last = run.reasons.length - 1;
    return run.reasons.flatMap((reason, i) => {
      if (run.stopped && i === last) return [`stopped at ${moment(run.time[run.time.length - 1])} s: ${reason}`];
      return since === null ? [] : [i ? reason : `invalid from ${moment(since)} s: ${reason}`];
    });
  }

  /* One line; the others unfold. */
  alarm(lines) {
    const box = $("alarm"), text = lines.join("\n");
    if (box.dataset.text === text) return;
    box.dataset.text = text;
    box.hidden = !lines.length;
    box.querySelector("summary").textContent = lines[0] || "";
    box.classList.toggle("single", lines.length < 2);
    box.querySelector("div").textContent = lines.slice(1).join("\n");
  }

  frame(now) {
    const passed = Math.min(0.1, Math.max(0, now - this.last) / 1000); // a frame begins before `last`
    this.last = now;
    if (this.playing && this.end > this.begin) {
      this.t += passed * this.speed;
      if (this.t > this.end) this.t = this.begin;
      this.stale = true;
    }
    if (this.stale) {
      this.stale = false;
      this.scene.draw(this.t);
      this.curves.show(this.t);
      this.facts();
      $("time").value = this.t;
      const { t, decimals } = this;
      $("now").textContent = `${decimals > 8 ? t.toExponential(4) : t.toFixed(decimals)} s`;
      $("play").textContent = this.playing ? "pause" : "play";
    }
    requestAnimationFrame((next) => this.frame(next));
  }
}

/* A recorded run: one packed array of 4-byte floats, column by column, each with an offset and a size. */
async function recorded(run, columns) {
  const numbers = new Float32Array(await unpacked(run.packed)), { n, m, width, bases, sizes } = run;
  let next = 0, column = 0;
  const take = (count) => {
    const base = bases[column], size = sizes[column++];
    return Float64Array.from(numbers.subarray(next, (next += count)), (x) => base + size * x);
  };
  const time = take(n), rows = new Float64Array(n * width);
  for (let k = 0; k < width; ++k) rows.set(take(n), k * n);
  const curve_time = take(m), values = Array.from({ length: columns }, () => take(m));
  return { ...run, time, rows, across: 1, down: n, curves: { time: curve_time, values } };
}

async function begin() {
  const data = JSON.parse($("data").textContent);
  if (!data.live) {
    const results = await Promise.all(data.runs.map((run) => recorded(run, data.columns.length)));
    window.player = new Player(data, results);
    return;
  }
  const solver = await Solver.of(data.live);
  let waiting = false, latest = null;
  const compute = () => {
    const start = performance.now(), result = solver.run(settings.chosen);
    latest = result.time.length ? result : null;
    $("csv").disabled = !latest;
    $("cost").textContent = [`computed in ${shown(performance.now() - start)} ms`, settings.trouble]
      .filter(Boolean).join("; ");
    if (latest) settings.take(latest);
    if (!window.player) window.player = new Player(data, [latest || solver.run(new Map())]);
    else if (latest) window.player.take([latest]);
    if (!latest) window.player.fail(result.reasons.join("; ") || "the model cannot start with these values");
  };
  const settings = new Settings(data.live, $("live"), () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      compute();
    });
  });
  $("live").hidden = false;
  window.solver = solver;
  compute();
  $("reset").addEventListener("click", () => settings.reset());
  $("link").addEventListener("click", () =>
    navigator.clipboard ? navigator.clipboard.writeText(settings.link) : prompt("link", settings.link));
  $("csv").addEventListener("click", () => {
    const { time, values } = latest.curves, head = ["time", ...data.columns.map((c) => c.name)].join();
    const lines = Array.from(time, (t, i) => [t, ...values.map((v) => v[i])].join());
    saved(new Blob([[head, ...lines].join("\n"), "\n"], { type: "text/csv" }), `${document.title}.csv`);
  });
}

begin().catch((error) => {
  $("facts").textContent = `This page needs WebGL and WebAssembly: ${error.message}`;
  throw error;
});
