"use strict";
(() => {
  // Tables copy as tab-separated text.
  const copied = async (text) => {
    try {
      await navigator.clipboard.writeText(text);
      return true;
    } catch {
      const area = document.createElement("textarea");
      area.value = text;
      document.body.append(area);
      area.select();
      const done = document.execCommand("copy");
      area.remove();
      return done;
    }
  };
  for (const button of document.querySelectorAll("button.copy")) {
    button.hidden = false;
    const label = button.innerHTML;
    button.addEventListener("click", async () => {
      // What stands on lines of its own in a cell, such as an interval below its median, gets a column of its own.
      const rows = [...button.closest("figure").querySelectorAll("tr")].map((row) => [...row.cells].map(
        (cell) => cell.textContent.trim().split("\n").map((line) => line.trim().replace(/\s+/g, " "))));
      const lines = rows[0].map((_, k) => Math.max(...rows.map((row) => row[k].length)));
      const text = rows.map((row) => row.flatMap(
        (cell, k) => [...cell, ...Array(lines[k] - cell.length).fill("")]).join("\t")).join("\n");
      button.textContent = (await copied(text)) ? "Copied" : "Could not copy";
      setTimeout(() => { button.innerHTML = label; }, 1500);
    });
  }
  for (const button of document.querySelectorAll("button.enlarge")) {
    button.hidden = false;
    button.addEventListener("click", () => {
      const large = button.closest("figure").classList.toggle("large");
      button.setAttribute("aria-pressed", String(large));
      button.firstChild.data = large ? "Fit to the page" : "Enlarge";
    });
  }

  // On paper nothing can be unfolded: what belongs there is opened for as long as it takes.
  let unfolded = [];
  addEventListener("beforeprint", () => {
    unfolded = [...document.querySelectorAll("details.paper:not([open])")];
    for (const part of unfolded) part.open = true;
  });
  addEventListener("afterprint", () => {
    for (const part of unfolded) part.open = false;
    unfolded = [];
  });

  const unpack = (packed) => {
    const bytes = Uint8Array.from(atob(packed.data), (c) => c.charCodeAt(0));
    const steps = new DataView(bytes.buffer);
    const out = new Float64Array(bytes.length / 2);
    for (let i = 0; i < out.length; i += 1) {
      const step = steps.getInt16(2 * i, true);
      out[i] = step === -32768 ? NaN : packed.low + packed.scale * (step + 32767);
    }
    return out;
  };
  const nice = (span, count) => {
    const raw = span / count;
    const power = 10 ** Math.floor(Math.log10(raw));
    return power * [1, 2, 5, 10].find((m) => m * power >= raw);
  };
  const ticks = (low, high, count) => {
    if (!(high > low)) return [low];
    const step = nice(high - low, count);
    const out = [];
    for (let k = Math.ceil(low / step); k * step <= high + step * 1e-9; k += 1) out.push(k * step);
    return out;
  };
  const label = (x, step) => {
    if (x === 0) return "0";
    const digits = Math.max(0, Math.min(6, -Math.floor(Math.log10(step) + 1e-9)));
    return Math.abs(x) >= 1e5 || Math.abs(x) < 1e-4 ? x.toExponential(1) : x.toFixed(digits);
  };
  const short = (x) => (Number.isFinite(x) ? Number(x.toPrecision(4)).toString() : "–");

  const LINE = 16;  // pixels, of a legend

  class Chart {
    constructor(figure) {
      this.canvas = figure.querySelector("canvas");
      this.readout = figure.querySelector(".readout");
      this.paper = figure.querySelector(".on-paper");
      this.views = JSON.parse(figure.querySelector("script").textContent).views;
      this.printing = false;
      const controls = figure.querySelector(".controls");
      controls.hidden = false;
      const select = controls.querySelector("select");
      this.views.forEach((view, i) => select.add(new Option(view.label, String(i))));
      if (this.views.length < 2) select.parentElement.hidden = true;
      select.addEventListener("change", () => this.show(Number(select.value)));
      for (const button of controls.querySelectorAll("[data-zoom]")) {
        button.addEventListener("click", () => this.zoom(button.dataset.zoom));
      }
      this.listen();
      this.show(0);
    }

    show(index) {
      const view = this.views[index];
      if (!view.ready) {
        view.points = unpack(view.at);
        for (const panel of view.panels) {
          for (const s of panel.series) {
            for (const key of ["x", "y", "low", "high"]) if (s[key]) s[key] = unpack(s[key]);
          }
        }
        const known = view.points.filter(Number.isFinite);
        view.extent = [known.reduce((a, b) => Math.min(a, b), Infinity), known.reduce((a, b) => Math.max(a, b), -Infinity)];
        view.ready = true;
      }
      this.view = view;
      const tall = view.panels.reduce((sum, p) => sum + p.height, 0);
      this.canvas.style.height = `${Math.max(22, 4 + 5.5 * tall)}rem`;
      this.range = [...view.extent];
      this.cursor = null;
      const more = this.views.length > 1 ? ` (one of ${this.views.length}; the page on a screen shows all)` : "";
      this.paper.textContent = `Shown: ${view.label}${more}.`;
      this.readout.textContent = "Point at the chart to read values; drag over a stretch to zoom, double-click for all.";
      this.draw();
    }

    zoom(how) {
      const [a, b] = this.range;
      const middle = this.cursor ?? (a + b) / 2;
      if (how === "all") this.range = [...this.view.extent];
      else {
        const half = ((b - a) / 2) * (how === "in" ? 0.5 : 2);
        const [low, high] = this.view.extent;
        this.range = [Math.max(low, middle - half), Math.min(high, middle + half)];
        if (how === "in" && this.range[1] - this.range[0] < (high - low) * 1e-4) this.range = [a, b];
      }
      this.draw();
    }

    listen() {
      const canvas = this.canvas;
      let from = null;
      const at = (event) => {
        const box = canvas.getBoundingClientRect();
        const share = (event.clientX - box.left - this.left) / (box.width - this.left - this.right);
        return this.range[0] + Math.min(1, Math.max(0, share)) * (this.range[1] - this.range[0]);
      };
      canvas.addEventListener("pointerdown", (event) => { from = at(event); canvas.setPointerCapture(event.pointerId); });
      canvas.addEventListener("pointermove", (event) => {
        this.cursor = at(event);
        this.chosen = from === null ? null : [Math.min(from, this.cursor), Math.max(from, this.cursor)];
        this.announce();
        this.draw();
      });
      const end = () => {
        const chosen = this.chosen;
        from = null;
        this.chosen = null;
        if (chosen && chosen[1] - chosen[0] > (this.range[1] - this.range[0]) * 0.01) this.range = chosen;
        this.draw();
      };
      canvas.addEventListener("pointerup", end);
      canvas.addEventListener("pointercancel", () => { from = null; this.chosen = null; this.draw(); });
      canvas.addEventListener("pointerleave", () => { if (from === null) { this.cursor = null; this.draw(); } });
      canvas.addEventListener("dblclick", () => this.zoom("all"));
      canvas.addEventListener("keydown", (event) => {
        const step = (this.range[1] - this.range[0]) / 100;
        const middle = (this.range[0] + this.range[1]) / 2;
        if (event.key === "ArrowLeft") this.cursor = Math.max(this.range[0], (this.cursor ?? middle) - step);
        else if (event.key === "ArrowRight") this.cursor = Math.min(this.range[1], (this.cursor ?? middle) + step);
        else if (event.key === "+" || event.key === "=") this.zoom("in");
        else if (event.key === "-") this.zoom("out");
        else if (event.key === "0") this.zoom("all");
        else return;
        event.preventDefault();
        this.announce();
        this.draw();
      });
      new ResizeObserver(() => this.draw()).observe(canvas);
      matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
      addEventListener("beforeprint", () => { this.printing = true; this.draw(); });
      addEventListener("afterprint", () => { this.printing = false; this.draw(); });
    }

    nearest(x) {
      let best = -1;
      for (let i = 0; i < x.length; i += 1) {
        if (Number.isFinite(x[i]) && (best < 0 || Math.abs(x[i] - this.cursor) < Math.abs(x[best] - this.cursor))) best = i;
      }
      return best;
    }

    announce() {
      if (this.cursor === null || this.cursor === undefined) return;
      const own = this.view.points;
      const i = this.nearest(own);
      const parts = [`${this.view.x}: ${short(own[i])}`];
      for (const panel of this.view.panels) {
        for (const s of panel.series) {
          const k = s.x ? this.nearest(s.x) : i;
          const value = s.kind === "band" ? `${short(s.low[k])} to ${short(s.high[k])}` : short(s.y[k]);
          parts.push(`${s.name}: ${value}`);
        }
      }
      this.readout.textContent = parts.join("; ");
    }

    colours() {
      if (this.printing) {
        const c = ["#0072b2", "#d55e00", "#009e73", "#b0568f", "#a87400", "#2f8fc4", "#3c4650"];
        return { ground: "#ffffff", ink: "#000000", soft: "#333333", line: "#bbbbbb", c };
      }
      const style = getComputedStyle(document.documentElement);
      const get = (name) => style.getPropertyValue(name).trim();
      const c = [0, 1, 2, 3, 4, 5, 6].map((k) => get(`--c${k}`));
      return { ground: get("--ground"), ink: get("--ink"), soft: get("--soft"), line: get("--line"), c };
    }

    draw() {
      // On paper the style fits the picture to the page, so it is drawn in a size and a sharpness of its own.
      const tall = this.view.panels.reduce((sum, p) => sum + p.height, 0);
      const width = this.printing ? 680 : this.canvas.clientWidth;
      const height = this.printing ? 60 + 62 * tall : this.canvas.clientHeight;
      if (!width || !height) return;
      const ratio = this.printing ? 3 : window.devicePixelRatio || 1;
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
      const g = this.canvas.getContext("2d");
      g.scale(ratio, ratio);
      const colour = this.colours();
      g.fillStyle = colour.ground;
      g.fillRect(0, 0, width, height);
      g.font = "12px system-ui, sans-serif";
      this.left = 58;
      this.right = 12;
      const [a, b] = this.range;
      const right = width - this.right;
      const X = (x) => this.left + ((x - a) / (b - a || 1)) * (right - this.left);
      const total = this.view.panels.reduce((sum, p) => sum + p.height, 0);
      const room = height - 40;
      const steps = ticks(a, b, Math.max(2, (right - this.left) / 90));
      let top = 0;
      this.beyond = 0;
      for (const panel of this.view.panels) {
        const share = (room * panel.height) / total;
        const lines = this.lines(g, panel, right);
        this.panel(g, panel, { X, top: top + 20 + LINE * lines.length, bottom: top + share - 4, right, colour, steps, lines });
        top += share;
      }
      this.canvas.dataset.beyond = String(this.beyond);
      g.fillStyle = colour.ink;
      g.textAlign = "center";
      const step = steps.length > 1 ? steps[1] - steps[0] : 1;
      for (const x of steps) g.fillText(label(x, step), X(x), room + 12);
      g.fillText(this.view.x, (this.left + right) / 2, height - 8);
      if (this.chosen) {
        g.globalAlpha = 0.2;
        g.fillStyle = colour.c[0];
        g.fillRect(X(this.chosen[0]), 0, X(this.chosen[1]) - X(this.chosen[0]), room);
        g.globalAlpha = 1;
      }
      if (this.cursor !== null && this.cursor !== undefined && !this.printing) {
        g.strokeStyle = colour.soft;
        g.beginPath();
        g.moveTo(X(this.cursor), 18);
        g.lineTo(X(this.cursor), room);
        g.stroke();
      }
    }

    panel(g, panel, { X, top, bottom, right, colour, steps, lines }) {
      const [a, b] = this.range;
      let low = Infinity;
      let high = -Infinity;
      const most = this.reach(panel);
      for (const s of panel.series) {
        const x = s.x || this.view.points;
        for (const values of s.kind === "band" ? [s.low, s.high] : [s.y]) {
          for (let i = 0; i < x.length; i += 1) {
            if (x[i] >= a && x[i] <= b && Math.abs(values[i]) <= most) {
              low = Math.min(low, values[i]);
              high = Math.max(high, values[i]);
            }
          }
        }
      }
      if (!(high >= low)) [low, high] = [0, 1];
      const margin = (high - low || Math.abs(high) || 1) * 0.06;
      [low, high] = [low - margin, high + margin];
      const Y = (y) => bottom - ((y - low) / (high - low)) * (bottom - top);
      const rows = ticks(low, high, Math.max(4, (bottom - top) / 36));
      const step = rows.length > 1 ? rows[1] - rows[0] : 1;
      g.lineWidth = 1;
      g.strokeStyle = colour.line;
      g.fillStyle = colour.ink;
      g.textAlign = "right";
      for (const y of rows) {
        g.beginPath();
        g.moveTo(this.left, Y(y));
        g.lineTo(right, Y(y));
        g.stroke();
        g.fillText(label(y, step), this.left - 6, Y(y) + 4);
      }
      g.globalAlpha = 0.5;
      for (const x of steps) {
        g.beginPath();
        g.moveTo(X(x), top);
        g.lineTo(X(x), bottom);
        g.stroke();
      }
      g.globalAlpha = 1;
      g.textAlign = "left";
      g.fillText(panel.y, this.left, top - 7 - LINE * lines.length);
      this.legend(g, panel, { top, right, colour, lines });
      g.save();
      g.beginPath();
      g.rect(this.left, top, right - this.left, bottom - top);
      g.clip();
      this.edges = { top, bottom };
      for (const s of panel.series) this.series(g, s, X, Y, colour, most);
      g.restore();
    }

    // Where points are alone, as residuals are: the few that lie ten times as far out as nearly all others would hide
    // these. How far out points count for the axis; those beyond are triangles at its edge.
    reach(panel) {
      if (panel.series.some((s) => s.kind !== "points")) return Infinity;
      const [a, b] = this.range;
      const sizes = panel.series.flatMap((s) => [...s.y].filter(
        (y, i) => Number.isFinite(y) && (s.x || this.view.points)[i] >= a && (s.x || this.view.points)[i] <= b)).map(Math.abs);
      sizes.sort((one, other) => one - other);
      return 10 * sizes[Math.floor(0.98 * (sizes.length - 1))] || Infinity;
    }

    far(g, x, up) {
      this.beyond += 1;
      const edge = up ? this.edges.top : this.edges.bottom;
      const base = edge + (up ? 8 : -8);
      g.beginPath();
      g.moveTo(x, edge);
      g.lineTo(x - 5, base);
      g.lineTo(x + 5, base);
      g.fill();
    }

    // Series in lines: one beside the name of the axis where all fit there, else lines of their own below it.
    lines(g, panel, right) {
      const wide = (s) => g.measureText(s.name).width + 26;
      const after = this.left + g.measureText(panel.y).width + 16;
      const all = panel.series.reduce((sum, s) => sum + wide(s), 0);
      if (all <= right - after) return [];
      const out = [[]];
      let left = right - this.left;
      for (const s of panel.series) {
        if (wide(s) > left && out.at(-1).length) { out.push([]); left = right - this.left; }
        out.at(-1).push(s);
        left -= wide(s);
      }
      return out;
    }

    legend(g, panel, { top, right, colour, lines }) {
      const rows = lines.length ? lines : [panel.series];
      const wide = (s) => g.measureText(s.name).width + 26;
      rows.forEach((row, k) => {
        const y = top - 7 - LINE * (rows.length - 1 - k);
        let x = lines.length ? this.left : right + 8 - row.reduce((sum, s) => sum + wide(s), 0);
        for (const s of row) {
          g.fillStyle = colour.c[s.colour % 7];
          g.globalAlpha = s.kind === "band" ? 0.35 : 1;
          if (s.kind === "points") { g.beginPath(); g.arc(x + 7, y - 4, 2.5, 0, 7); g.fill(); }
          else g.fillRect(x, y - (s.kind === "band" ? 8 : 5), 11, s.kind === "band" ? 9 : 2);
          g.globalAlpha = 1;
          g.fillStyle = colour.ink;
          g.fillText(s.name, x + 15, y);
          x += wide(s);
        }
      });
    }

    series(g, s, X, Y, colour, most) {
      const x = s.x || this.view.points;
      const [a, b] = this.range;
      const pad = (b - a) * 0.02;
      const inside = (i) => x[i] >= a - pad && x[i] <= b + pad;
      g.fillStyle = colour.c[s.colour % 7];
      g.strokeStyle = g.fillStyle;
      if (s.kind === "points") {
        const size = x.length > 800 ? 1.2 : 2;
        for (let i = 0; i < x.length; i += 1) {
          if (!inside(i) || !Number.isFinite(s.y[i])) continue;
          if (Math.abs(s.y[i]) <= most) g.fillRect(X(x[i]) - size, Y(s.y[i]) - size, 2 * size, 2 * size);
          else this.far(g, X(x[i]), s.y[i] > 0);
        }
      } else if (s.kind === "line") {
        g.lineWidth = 1.6;
        g.setLineDash([[], [7, 4], [2, 3], [9, 3, 2, 3]][s.colour % 4]);
        g.beginPath();
        let down = false;
        for (let i = 0; i < x.length; i += 1) {
          if (!Number.isFinite(s.y[i])) { down = false; continue; }
          if (down) g.lineTo(X(x[i]), Y(s.y[i]));
          else g.moveTo(X(x[i]), Y(s.y[i]));
          down = true;
        }
        g.stroke();
        g.setLineDash([]);
      } else {
        g.globalAlpha = 0.3;
        g.beginPath();
        for (let i = 0; i < x.length; i += 1) if (Number.isFinite(s.high[i])) g.lineTo(X(x[i]), Y(s.high[i]));
        for (let i = x.length - 1; i >= 0; i -= 1) if (Number.isFinite(s.low[i])) g.lineTo(X(x[i]), Y(s.low[i]));
        g.fill();
        g.globalAlpha = 1;
      }
    }
  }
  for (const figure of document.querySelectorAll("figure.chart")) new Chart(figure);
  document.documentElement.dataset.drawn = String(document.querySelectorAll("figure.chart").length);
})();
