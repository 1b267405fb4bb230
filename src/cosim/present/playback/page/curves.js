"use strict";
/* Curves of the chosen variables, one chart for each unit, with a mark at the present time. */

/* Values at times, linear between samples; null outside. */
function sampled(times, samples, wanted) {
  return Array.from(wanted, (t) => {
    if (t < times[0] || t > times[times.length - 1]) return null;
    const [i, j, s] = station(times, t);
    return samples[i] + s * (samples[j] - samples[i]);
  });
}

class Curves {
  constructor(data, place, choice, jump) {
    this.data = data;
    this.place = place;
    this.jump = jump;
    this.charts = [];
    this.chosen = new Set(data.chosen);
    data.columns.forEach((column, k) => {
      const line = document.createElement("label"), box = document.createElement("input");
      box.type = "checkbox";
      box.checked = this.chosen.has(k);
      box.addEventListener("change", () => {
        if (box.checked) this.chosen.add(k); else this.chosen.delete(k);
        this.build();
      });
      line.append(box, ` ${column.name}`);
      line.title = column.unit ? `${column.meaning} [${column.unit}]` : column.meaning;
      choice.append(line);
    });
  }

  take(results) {
    this.results = results;
    if (this.charts.length) this.fill(); else this.build();
  }

  build() {
    for (const { plot } of this.charts) plot.destroy();
    const units = new Map();
    for (const k of [...this.chosen].sort((a, b) => a - b)) {
      const { unit } = this.data.columns[k];
      units.set(unit, [...(units.get(unit) || []), k]);
    }
    this.charts = [...units].map(([unit, columns]) => this.chart(unit, columns));
    this.fill();
  }

  chart(unit, columns) {
    const style = getComputedStyle(document.body), { colors } = this.data;
    const color = style.getPropertyValue("--ink"), faint = style.getPropertyValue("--faint");
    const values = (_, ticks) => ticks.map((tick) => stepped(tick, ticks[1] - ticks[0] || tick));
    const axis = { stroke: color, grid: { stroke: faint, width: 1 }, ticks: { stroke: faint }, values };
    const { time } = this.results[0].curves, span = time[time.length - 1] - time[0];
    const lines = this.results.flatMap((run, i) => columns.map((k, position) => ({
      label: this.data.columns[k].name + (i ? ` (${this.different(run)})` : ""),
      stroke: colors[position % colors.length],
      dash: i ? [4 + 2 * i, 4] : position && this.results.length < 2 ? [10, 3 + 2 * position] : undefined, // equal ones show
      width: i ? 1 : 1.8,
      pxAlign: 0, // slow curves would be stairs of pixels
      points: { show: time.length < 2 },
      value: (_, v) => (v === null ? "-" : `${shown(v)} ${unit}`),
    })));
    const options = {
      width: this.place.clientWidth, height: 170, legend: { live: true }, cursor: { drag: { x: false, y: false } },
      scales: { x: { time: false }, y: { range: (plot) => this.reach(plot) } },
      series: [{ label: "t", value: (_, v) => (v === null ? "-" : `${stepped(v, span / 100 || v)} s`) }, ...lines],
      axes: [{ ...axis, size: 34, space: (_, axis, low, high) => 20 + 7 * stepped(high - (high - low) / 40, (high - low) / 40).length },
        { ...axis, size: (_, texts) => Math.max(62, 20 + 7 * Math.max(...(texts || [""]).map((s) => s.length))),
          label: unit, labelSize: 18 }],
    };
    const plot = new uPlot(options, [[]], this.place);
    plot.over.addEventListener("click", (e) => this.jump(plot.posToVal(e.offsetX, "x")));
    const mark = plot.over.appendChild(document.createElement("div"));
    mark.className = "moment";
    return { plot, columns, mark };
  }

  /* The words of a run's title that the first one's lacks. */
  different(run) {
    const first = this.results[0].title.split(", ");
    return run.title.split(", ").filter((word) => !first.includes(word)).join(", ") || "other run";
  }

  fill() {
    const { time } = this.results[0].curves;
    for (const chart of this.charts) {
      const rows = this.results.flatMap(({ curves }, i) => chart.columns.map((k) => {
        const { factor, offset } = this.data.columns[k], own = curves.values[k];
        const values = i ? sampled(curves.time, own, time) : Array.from(own);
        return values.map((v) => (Number.isFinite(v) ? v * factor + offset : null));
      }));
      chart.plot.setData([Array.from(time), ...rows]);
      queueMicrotask(() => this.annotate(chart)); // uPlot finds its scales in one, too
    }
  }

  /* The range of a chart's values while the runs are valid; what comes after may leave it. */
  reach({ data: [time, ...rows] }) {
    const count = rows.length / this.results.length;
    const own = rows.flatMap((row, i) => {
      const since = this.results[Math.floor(i / count)].invalid_from;
      const valid = since === null ? row : row.filter((_, k) => time[k] <= since);
      return (valid.length > 1 ? valid : row).filter((v) => v !== null);
    });
    const [low, high] = [Math.min, Math.max].map((pick) => own.reduce((a, b) => pick(a, b), own[0] || 0));
    const gap = high - low > 1e-9 * Math.max(high, -low) ? high - low : Math.abs(high) || 10;
    return [low - 0.1 * gap, high + 0.1 * gap];
  }

  /* Lines at events, and a shade where the run is invalid. */
  annotate({ plot }) {
    for (const old of plot.over.querySelectorAll(".event, .invalid")) old.remove();
    const [first] = this.results;
    const add = (name, time, text) => {
      const line = plot.over.appendChild(document.createElement("div"));
      line.className = name;
      line.title = text;
      line.style.left = `${plot.valToPos(time, "x")}px`;
    };
    for (const [time, text] of first.events) add("event", time, text);
    if (first.invalid_from !== null) add("invalid", first.invalid_from, first.reasons.join("; "));
  }

  show(t) {
    const [before, after, s] = station(this.results[0].curves.time, t), row = s < 0.5 ? before : after;
    for (const { plot, mark } of this.charts) {
      mark.style.left = `${plot.valToPos(t, "x")}px`;
      plot.setLegend({ idx: row }, false);
    }
  }

  resize() {
    for (const { plot } of this.charts) plot.setSize({ width: this.place.clientWidth, height: 170 });
    if (this.results) for (const chart of this.charts) this.annotate(chart);
  }
}
