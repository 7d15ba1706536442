// Lines over time on a canvas: one scale a unit, axes at both sides, zoom by dragging, a cursor
// whose values stand in the legend.
const AXIS_X = 4, AXIS_Y = 5.8; // heights of the text, below the plot and beside it

const steps = (low, high, most) => {
  const raw = (high - low) / Math.max(most, 1);
  if (!(raw > 0) || !isFinite(raw)) return [];
  const ten = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((k) => k * ten >= raw) * ten;
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found;
};

const part = (tag, name, host) => {
  const made = document.createElement(tag);
  made.className = name;
  host.append(made);
  return made;
};

export default class Plot {
  constructor(options, data, host) {
    this.options = options;
    this.root = part("div", "plot", host);
    this.canvas = part("canvas", "plot-canvas", this.root);
    this.over = part("div", "plot-over", this.root);
    this.hair = part("div", "plot-hair", this.over);
    this.box = part("div", "plot-select", this.over);
    this.legend = part("div", "plot-legend", this.root);
    this.values = options.series.map((s) => {
      const entry = part("span", "plot-entry", this.legend);
      if (s.stroke) part("i", "", entry).style.background = s.stroke;
      part("b", "", entry).textContent = s.label;
      return part("span", "plot-value", entry);
    });
    this.ctx = this.canvas.getContext("2d");
    this.cursor = { left: -1 };
    this.select = { width: 0 };
    this.scales = Object.fromEntries(Object.keys(options.scales).map((k) => [k, { min: 0, max: 1 }]));
    this.over.addEventListener("mousemove", (e) => this.move(e));
    this.over.addEventListener("mouseleave", () => this.leave());
    this.over.addEventListener("mousedown", (e) => { if (!e.shiftKey && !e.altKey) this.from = e.offsetX; });
    this.up = (e) => this.release(e);
    window.addEventListener("mouseup", this.up);
    this.over.addEventListener("dblclick", () => setTimeout(() => this.setData(this.data, true)));
    this.data = data;
    options.hooks.ready.forEach((hook) => hook(this));
    this.setSize(options);
    this.setData(data, true);
  }

  destroy() {
    window.removeEventListener("mouseup", this.up);
    this.root.remove();
  }

  setSize({ width, height }) {
    this.width = width;
    this.height = height;
    const axes = this.options.axes.slice(1);
    this.wide = AXIS_Y * this.options.text;
    const room = (side) => axes.filter((a) => a.side === side).length * this.wide + 10;
    this.left = room(3);
    this.inner = Math.max(width - this.left - room(1), 10);
    this.tall = Math.max(height - AXIS_X * this.options.text - 8, 10);
    const r = devicePixelRatio;
    this.canvas.width = width * r;
    this.canvas.height = height * r;
    Object.assign(this.canvas.style, { width: `${width}px`, height: `${height}px` });
    Object.assign(this.over.style, { left: `${this.left}px`, top: "8px", width: `${this.inner}px`, height: `${this.tall}px` });
    this.bbox = { left: this.left * r, top: 8 * r, width: this.inner * r, height: this.tall * r };
    this.redraw();
  }

  setData(data, reset) {
    this.data = data;
    if (reset) this.range("x", data[0]);
    this.redraw();
  }

  range(key, ...columns) {
    let low = Infinity, high = -Infinity;
    for (const column of columns) for (const v of column) if (isFinite(v)) { if (v < low) low = v; if (v > high) high = v; }
    const [min, max] = this.options.scales[key].range(this, low <= high ? low : null, low <= high ? high : null);
    this.scales[key] = { min, max };
  }

  valToPos(value, key, onCanvas) {
    const { min, max } = this.scales[key];
    const share = (value - min) / (max - min);
    const at = key === "x" ? share * this.inner : (1 - share) * this.tall;
    return onCanvas ? (at + (key === "x" ? this.left : 8)) * devicePixelRatio : at;
  }

  posToVal(at) {
    const { min, max } = this.scales.x;
    return min + (at / this.inner) * (max - min);
  }

  redraw() {
    if (!this.data) return;
    const { ctx, options, data } = this, r = devicePixelRatio;
    for (const key of Object.keys(this.scales)) {
      if (key !== "x") this.range(key, ...data.filter((_, i) => i && options.series[i].scale === key));
    }
    ctx.setTransform(r, 0, 0, r, 0, 0);
    ctx.clearRect(0, 0, this.width, this.height);
    const places = { 1: 0, 3: 0 };
    options.axes.forEach((axis, i) => (i ? this.side(axis, places[axis.side]++) : this.bottom(axis)));
    ctx.save();
    ctx.beginPath(); ctx.rect(this.left, 8, this.inner, this.tall); ctx.clip();
    ctx.lineJoin = "round";
    options.series.forEach((s, i) => {
      if (!i) return;
      ctx.strokeStyle = s.stroke; ctx.lineWidth = s.width;
      ctx.beginPath();
      let pen = false;
      for (let k = 0; k < data[0].length; k++) {
        const v = data[i][k];
        if (!isFinite(v)) { pen = false; continue; }
        const x = this.left + this.valToPos(data[0][k], "x"), y = 8 + this.valToPos(v, s.scale);
        if (pen) ctx.lineTo(x, y); else ctx.moveTo(x, y);
        pen = true;
      }
      ctx.stroke();
    });
    ctx.restore();
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    options.hooks.draw.forEach((hook) => hook(this));
    this.tell();
  }

  bottom(axis) {
    const { ctx } = this, { min, max } = this.scales.x;
    ctx.font = axis.font; ctx.textAlign = "center"; ctx.textBaseline = "top"; ctx.lineWidth = 1;
    const ticks = steps(min, max, this.inner / 90);
    axis.values(this, ticks).forEach((text, k) => {
      const x = Math.round(this.left + this.valToPos(ticks[k], "x")) + 0.5;
      ctx.strokeStyle = axis.grid.stroke;
      ctx.beginPath(); ctx.moveTo(x, 8); ctx.lineTo(x, this.tall + 14); ctx.stroke();
      ctx.fillStyle = axis.stroke; ctx.fillText(text, x, this.tall + 16);
    });
    ctx.fillStyle = axis.stroke;
    ctx.fillText(axis.label, this.left + this.inner / 2, this.tall + 16 + 1.4 * this.options.text);
  }

  side(axis, place) {
    const { ctx } = this, { min, max } = this.scales[axis.scale], right = axis.side === 1;
    const edge = right ? this.left + this.inner + place * this.wide : this.left - place * this.wide;
    const out = right ? 1 : -1;
    ctx.font = axis.font; ctx.textAlign = right ? "left" : "right"; ctx.textBaseline = "middle"; ctx.lineWidth = 1;
    const ticks = steps(min, max, this.tall / 45);
    axis.values(this, ticks).forEach((text, k) => {
      const y = Math.round(8 + this.valToPos(ticks[k], axis.scale)) + 0.5;
      ctx.strokeStyle = axis.grid.stroke;
      ctx.beginPath(); ctx.moveTo(edge, y); ctx.lineTo(edge + 5 * out, y); ctx.stroke();
      if (axis.grid.show) { ctx.beginPath(); ctx.moveTo(this.left, y); ctx.lineTo(this.left + this.inner, y); ctx.stroke(); }
      ctx.fillStyle = axis.stroke; ctx.fillText(text, edge + 8 * out, y);
    });
    ctx.save();
    ctx.translate(edge + (this.wide - 0.75 * this.options.text) * out, 8 + this.tall / 2);
    ctx.rotate(-Math.PI / 2);
    ctx.textAlign = "center"; ctx.fillStyle = axis.stroke;
    ctx.fillText(axis.label, 0, 0);
    ctx.restore();
  }

  move(e) {
    this.cursor.left = e.offsetX;
    this.hair.style.left = `${e.offsetX}px`;
    this.hair.style.display = "block";
    if (this.from != null) {
      Object.assign(this.box.style, { display: "block", left: `${Math.min(this.from, e.offsetX)}px`, width: `${Math.abs(e.offsetX - this.from)}px` });
    }
    this.tell();
  }

  leave() {
    this.cursor.left = -1;
    this.hair.style.display = "none";
    this.tell();
  }

  release(e) {
    if (this.from == null) return;
    const to = e.clientX - this.over.getBoundingClientRect().left, from = this.from;
    this.from = null;
    this.box.style.display = "none";
    const [a, b] = [from, Math.min(Math.max(to, 0), this.inner)].sort((p, q) => p - q);
    this.select.width = b - a;
    if (b - a <= 2) return;
    this.options.hooks.setSelect.forEach((hook) => hook(this));
    this.scales.x = { min: this.posToVal(a), max: this.posToVal(b) };
    this.redraw();
  }

  tell() {
    const xs = this.data[0];
    let k = xs.length - 1;
    if (this.cursor.left >= 0 && k > 0) {
      const x = this.posToVal(this.cursor.left);
      let low = 0;
      while (low < k) { const m = (low + k) >> 1; if (xs[m] < x) low = m + 1; else k = m; }
    }
    this.options.series.forEach((s, i) => { this.values[i].textContent = s.value(this, k < 0 ? null : this.data[i][k]); });
  }
}
