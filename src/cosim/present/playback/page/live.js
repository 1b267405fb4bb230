"use strict";
/* The model's own solver in the page: a slider moves, the whole run is computed anew. */

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const unpacked = async (text) =>
  new Response(new Blob([bytes(text)]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();

/* What is wrong, without the time; see fmu/runtime/validity.h. */
const violation = (line) => line.replace(/^invalid from \S+ s: /, "");

const EVENT = /: at (\S+) s: (.*)/; // as the runtime logs one

const UNNAMED = /^\S+ of (\(|.*, )/; // a relation inside an equation

/* A run of the compiled model; the numbers of `fmu/page/page.c`. */
class Solver {
  static async of(live) {
    const { instance } = await WebAssembly.instantiate(await unpacked(live.program), {});
    instance.exports._initialize();
    return new Solver(instance.exports, live);
  }

  constructor(program, live) {
    this.program = program;
    this.live = live;
    const { references, times, width, settings } = live;
    this.references = this.stored(Uint32Array.from(references));
    this.times = this.stored(Float64Array.from(times));
    this.rows = program.page_room(8 * times.length * width);
    this.set = program.page_room(4 * settings.length);
    this.values = program.page_room(8 * settings.length);
    this.given = program.page_room(12);
  }

  stored(array) {
    const place = this.program.page_room(array.byteLength);
    new array.constructor(this.program.memory.buffer, place, array.length).set(array);
    return place;
  }

  /* A run with settings by name, SI; those that are missing keep the model's own values. */
  run(chosen, most = Infinity) {
    const { program, live } = this, settings = this.resolved(chosen);
    const { buffer } = program.memory; // another one after a run that needed more memory
    const used = live.settings.filter(({ name }) => settings.has(name));
    new Uint32Array(buffer, this.set, used.length).set(used.map((s) => s.reference));
    new Float64Array(buffer, this.values, used.length).set(used.map((s) => settings.get(s.name)));
    new Uint32Array(buffer, this.given, 3).set([used.length, this.set, this.values]);
    const { width, times, references } = live, count = Math.min(most, times.length);
    const reached = program.page_run(this.given, references.length, this.references, count,
      this.times, width, this.rows);
    const rows = new Float64Array(program.memory.buffer, this.rows, reached * width).slice();
    const text = new Uint8Array(program.memory.buffer), start = program.page_messages();
    const messages = new TextDecoder().decode(text.slice(start, text.indexOf(0, start)));
    return this.result(rows, reached, messages.split("\n").filter(Boolean));
  }

  /* The settings with start values of states instead of those of outputs, such as a speed: found by
     secants, because a run tells which output follows from a start value. */
  resolved(chosen) {
    const settings = new Map(chosen);
    for (const { name, through, column, value } of this.live.settings) {
      if (!through || !settings.has(name)) continue;
      const target = settings.get(name), state = this.live.settings.find((s) => s.name === through);
      settings.delete(name);
      const missed = (start) => {
        const { curves } = this.run(new Map(settings).set(through, start), 2);
        return curves.time.length ? curves.values[column][0] - target : NaN;
      };
      let [start, other] = [state.value, (state.value * target) / value];
      if (!Number.isFinite(other) || other === start) other = start + (Math.abs(target - value) || 1);
      let [miss, next] = [missed(start), missed(other)];
      const enough = 1e-12 * Math.max(Math.abs(target), Math.abs(miss));
      for (let round = 0; round < 20 && Math.abs(next) > enough && next !== miss; ++round) {
        [start, other] = [other, other - (next * (other - start)) / (next - miss)];
        [miss, next] = [next, missed(other)];
      }
      settings.set(through, other);
    }
    return settings;
  }

  result(rows, reached, messages) {
    const { width, times, references, first, shapes } = this.live;
    const time = times.slice(0, reached);
    const column = (k) => Float64Array.from({ length: reached }, (_, i) => rows[i * width + k]);
    const values = Array.from({ length: references.length - first }, (_, k) => column(first + k));
    const rounded = (digits) => String(Number(Number(digits).toPrecision(6)));
    const plain = (line) => line.replace(/^\w+: /, "").replace(/\d+\.\d{5,}/g, rounded);
    const events = messages.map((line) => EVENT.exec(line)).filter((found) => found && !UNNAMED.test(found[2]));
    const lines = messages.filter((text) => !EVENT.test(text)).map(plain);
    const reasons = [...new Set(lines.map(violation))]; // what is violated again and again is one reason
    const stopped = reached < times.length;
    if (stopped && reached && !reasons.length) reasons.push(`the run ends at ${rounded(time[reached - 1])} s`);
    const since = lines.map((line) => /invalid from (\S+) s:/.exec(line)).find(Boolean);
    return {
      time, rows: rows.subarray(references.length), across: width, down: 1, title: "",
      shapes: reached ? Array.from(rows.subarray(width - shapes, width)) : [],
      curves: { time, values }, events: events.map(([, t, name]) => [Number(t), name]), reasons,
      invalid_from: since ? Number(since[1]) : null, stopped,
    };
  }
}

/* Sliders of start values, inputs and parameters. */
class Settings {
  constructor(live, place, changed) {
    this.live = live;
    this.changed = changed;
    this.chosen = new Map();
    this.lines = new Map();
    const titles = { input: "Inputs", start: "Start values", parameter: "Parameters" };
    for (const [kind, title] of Object.entries(titles)) {
      const own = live.settings.filter((s) => s.kind === kind);
      if (!own.length) continue;
      const group = place.appendChild(document.createElement("details"));
      group.open = own.length <= 12 || kind !== "parameter";
      group.appendChild(document.createElement("summary")).textContent = title;
      for (const setting of own) group.append(this.line(setting));
    }
    this.trouble = this.read();
    window.addEventListener("hashchange", () => {
      this.chosen.clear();
      this.trouble = this.read();
      live.settings.forEach((setting) => this.show(setting));
      changed();
    });
  }

  line(setting) {
    const { name, meaning, unit, factor, offset, low, high } = setting;
    const line = document.createElement("div"), mark = document.createElement("label");
    const slider = document.createElement("input"), field = document.createElement("input");
    line.className = "setting";
    mark.textContent = name;
    mark.title = meaning;
    mark.htmlFor = slider.id = `setting ${name}`;
    Object.assign(slider, { type: "range", min: low * factor + offset, max: high * factor + offset, step: "any" });
    Object.assign(field, { type: "number", step: "any" });
    field.setAttribute("aria-label", `${name}, ${unit}`);
    const end = Object.assign(document.createElement("span"), { textContent: unit });
    line.append(mark, slider, field, end);
    slider.addEventListener("input", () => this.choose(setting, (slider.valueAsNumber - offset) / factor));
    field.addEventListener("change", () => this.choose(setting, (field.valueAsNumber - offset) / factor));
    slider.addEventListener("dblclick", () => this.choose(setting, setting.value));
    this.lines.set(name, { mark, slider, field });
    this.show(setting);
    return line;
  }

  show(setting, followed = setting.value) {
    const { mark, slider, field } = this.lines.get(setting.name);
    const value = this.chosen.has(setting.name) ? this.chosen.get(setting.name) : followed;
    const displayed = value * setting.factor + setting.offset;
    slider.value = displayed;
    field.value = fitting(displayed);
    mark.classList.toggle("changed", this.chosen.has(setting.name));
  }

  choose(setting, value) {
    if (!Number.isFinite(value)) return this.show(setting); // an empty field, or 1e308 in a small unit
    for (const { name, through } of this.live.settings) { // one of two ways to set a start value
      if (through && name === setting.name) this.chosen.delete(through);
      if (through && through === setting.name) this.chosen.delete(name);
    }
    if (value === setting.value) this.chosen.delete(setting.name);
    else this.chosen.set(setting.name, value);
    this.show(setting);
    this.trouble = "";
    history.replaceState(null, "", this.link);
    this.changed();
  }

  /* Shows the start values that follow from others in a run. */
  take(result) {
    const { settings } = this.live, names = [...settings.map((s) => s.name)];
    for (const { name, through, column } of settings.filter((s) => s.through)) {
      const state = settings[names.indexOf(through)], output = settings[names.indexOf(name)];
      if (!this.chosen.has(name)) this.show(output, result.curves.values[column][0]);
      if (!this.chosen.has(through) && state.column !== undefined) this.show(state, result.curves.values[state.column][0]);
    }
  }

  reset() {
    this.chosen.clear();
    this.trouble = "";
    for (const setting of this.live.settings) this.show(setting);
    history.replaceState(null, "", this.link);
    this.changed();
  }

  get link() {
    const parts = [...this.chosen].map(([name, value]) => `${encodeURIComponent(name)}=${value}`);
    return `${location.href.split("#")[0]}${parts.length ? "#" : ""}${parts.join("&")}`;
  }

  /* Takes the settings that the page's address holds; returns what it cannot take. */
  read() {
    const trouble = [];
    for (const [name, text] of new URLSearchParams(location.hash.slice(1))) {
      const setting = this.live.settings.find((s) => s.name === name), value = Number(text);
      if (!setting) trouble.push(`the link sets '${name}', which this model does not have`);
      else if (!text.trim() || !Number.isFinite(value))
        trouble.push(`the link sets ${name} to '${text}', which is no number`);
      else this.chosen.set(name, value);
      if (setting) this.show(setting);
    }
    return trouble.join("; ");
  }
}
