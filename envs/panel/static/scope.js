// The oscilloscope: one scale a unit, zoom by dragging, two cursors, trigger lines.
import Plot from "uplot"; // MIT, its licence lies beside it

const numbers = (text) => {
  const raw = atob(text);
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return new Float32Array(bytes.buffer);
};

const nice = (v) => {
  if (v == null || !isFinite(v)) return "–";
  const a = Math.abs(v);
  if (a >= 1e6) return v.toPrecision(7);
  return (a >= 100 ? v.toFixed(1) : a >= 1 ? v.toFixed(3) : v.toFixed(4)).replace("-", "−");
};

export default {
  template: `<div class="scope-host" tabindex="0" @keydown="key" data-test="scope-plot">
      <div ref="plot" class="scope-plot"></div>
      <table class="scope-cursors" v-if="rows.length"><thead><tr><th></th><th>A</th><th>B</th><th>B − A</th></tr></thead>
      <tbody><tr v-for="r in rows" :key="r[0]"><td><i :style="{background: r[4]}"></i>{{ r[0] }}</td><td>{{ r[1] }}</td><td>{{ r[2] }}</td><td>{{ r[3] }}</td></tr></tbody></table></div>`,
  data: () => ({ rows: [] }),
  mounted() {
    this.data_ = null;
    this.channels_ = [];
    this.info_ = {};
    this.marks_ = { a: null, b: null };
    this.zoomed_ = false;
    this.watch_ = new ResizeObserver(() => this.fit());
    this.watch_.observe(this.$refs.plot);
    this.themes_ = new MutationObserver(() => this.build());
    this.themes_.observe(document.body, { attributes: true, attributeFilter: ["class"] });
    this.$emit("ready");
  },
  beforeUnmount() {
    this.watch_?.disconnect();
    this.themes_?.disconnect();
    this.plot_?.destroy();
  },
  methods: {
    size() {
      const box = this.$refs.plot.getBoundingClientRect();
      return { width: Math.max(box.width, 50), height: Math.max(box.height - 3.2 * parseFloat(getComputedStyle(document.documentElement).fontSize), 50) };
    },
    fit() {
      if (this.plot_ && this.$refs.plot.offsetParent) this.plot_.setSize(this.size());
    },
    colour(name) {
      return getComputedStyle(document.body).getPropertyValue(name).trim();
    },
    configure(channels) {
      this.channels_ = channels;
      this.data_ = [[], ...channels.map(() => [])];
      this.zoomed_ = false;
      this.marks_ = { a: null, b: null };
      this.rows = [];
      this.build();
    },
    build() {
      if (!this.channels_.length || !this.$refs.plot) return;
      this.plot_?.destroy();
      const ink = this.colour("--quiet"), grid = this.colour("--grid");
      const units = [...new Set(this.channels_.map((c) => c.axis))];
      const scales = { x: { time: false, range: (u, lo, hi) => (this.zoomed_ ? [lo, hi] : this.span()) } };
      const rem = parseFloat(getComputedStyle(document.documentElement).fontSize), small = Math.round(0.84 * rem);
      const font = `${small}px Roboto, system-ui, sans-serif`, minus = (text) => text.replace("-", "−");
      const axes = [{ stroke: ink, font, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid },
        size: 2.1 * small + 8, labelSize: 1.5 * small, labelFont: font, values: (u, vs) => vs.map((v) => (Math.abs(v) < 1e-9 ? "0" : minus(+v.toPrecision(4) + ""))), label: "time (s)" }];
      units.forEach((unit, i) => {
        const grain = Math.min(...this.channels_.filter((c) => c.axis === unit).map((c) => c.grain));
        scales["u" + i] = { auto: true, range: (u, lo, hi) => {
          if (lo == null || !isFinite(lo)) return [-1, 1];
          const room = Math.max((hi - lo) * 0.08, (Math.abs(hi) + Math.abs(lo)) * 1e-3, grain);
          return [lo - room, hi + room];
        } };
        if (i < 4) {
          const first = this.channels_.find((c) => c.axis === unit);
          const alone = this.channels_.filter((c) => c.axis === unit).length === 1;
          axes.push({ scale: "u" + i, side: i % 2 ? 1 : 3, stroke: alone ? first.colour : ink, font, size: 5.2 * small, labelSize: 1.6 * small, labelFont: font, label: (alone ? first.name.replaceAll("_", " ") + ", " : "") + first.unit, 
            grid: { show: i === 0, stroke: grid, width: 1 }, ticks: { stroke: grid },
            values: (u, vs) => vs.map((v) => minus(Math.abs(v) >= 1e5 ? +(v / 1e3).toPrecision(6) + "k" : +v.toPrecision(6) + "")) });
        }
      });
      const series = [{ label: "t (s)", value: (u, v) => nice(v) }].concat(this.channels_.map((c) => ({
        label: c.name, scale: "u" + units.indexOf(c.axis), stroke: c.colour, width: 1.6, points: { show: false },
        value: (u, v) => nice(v) })));
      this.plot_ = new Plot({ ...this.size(), padding: [8, 8, 0, 0], scales, axes, series, legend: { live: true },
        cursor: { drag: { x: true, y: false }, points: { size: 6 } },
        hooks: { draw: [(u) => this.marks(u)],
          setSelect: [(u) => { if (u.select.width > 2) { this.zoomed_ = true; } }],
          ready: [(u) => {
            u.over.addEventListener("mousedown", () => setTimeout(() => this.$el.focus({ preventScroll: true })));
            u.over.addEventListener("dblclick", () => setTimeout(() => this.unzoom()));
            u.over.addEventListener("click", (e) => { if (e.shiftKey) this.mark("a"); else if (e.altKey) this.mark("b"); });
          }] } }, this.data_, this.$refs.plot);
    },
    span() {
      return [this.info_.from ?? -1, this.info_.to ?? 0];
    },
    draw(packed, info) {
      this.info_ = info;
      if (!this.plot_) return;
      const all = numbers(packed), n = info.points;
      this.data_ = [];
      for (let i = 0; i <= this.channels_.length; i++) this.data_.push(all.subarray(i * n, (i + 1) * n));
      if (this.$refs.plot.offsetParent) {
        this.plot_.setData(this.data_, !this.zoomed_);
        if (this.zoomed_) this.plot_.redraw();
        this.table();
      }
      this.$el.dataset.points = n;
      this.$el.dataset.state = info.state;
    },
    line(u, x, colour, dash, text) {
      const at = Math.round(u.valToPos(x, "x", true));
      const { left, top, width, height } = u.bbox;
      if (at < left || at > left + width) return;
      const c = u.ctx;
      c.save();
      c.strokeStyle = c.fillStyle = colour;
      c.lineWidth = devicePixelRatio;
      c.setLineDash(dash);
      c.beginPath(); c.moveTo(at, top); c.lineTo(at, top + height); c.stroke();
      if (text) { c.font = `bold ${12 * devicePixelRatio}px Roboto, sans-serif`; c.fillText(text, at + 4, top + 14 * devicePixelRatio); }
      c.restore();
    },
    marks(u) {
      const ink = this.colour("--accent");
      if (this.info_.trigger) {
        this.line(u, 0, this.colour("--warn"), [6, 4], "T");
        const c = this.channels_.find((c) => c.name === this.info_.trigger.channel);
        const units = [...new Set(this.channels_.map((c) => c.axis))];
        if (c) {
          const y = Math.round(u.valToPos(this.info_.trigger.level, "u" + units.indexOf(c.axis), true));
          const { left, top, width, height } = u.bbox;
          if (y >= top && y <= top + height) {
            u.ctx.save();
            u.ctx.strokeStyle = this.colour("--warn"); u.ctx.setLineDash([6, 4]); u.ctx.lineWidth = devicePixelRatio;
            u.ctx.beginPath(); u.ctx.moveTo(left, y); u.ctx.lineTo(left + width, y); u.ctx.stroke();
            u.ctx.restore();
          }
        }
      }
      for (const [name, x] of Object.entries(this.marks_)) if (x != null) this.line(u, x, ink, [], name.toUpperCase());
    },
    mark(name) {
      const u = this.plot_;
      if (!u) return;
      const { min, max } = u.scales.x, left = u.cursor.left;
      this.marks_[name] = left >= 0 ? u.posToVal(left, "x") : min + (max - min) * (name === "a" ? 0.35 : 0.65);
      this.held_ = name;
      this.table();
      u.redraw(false);
    },
    step(samples) {
      const x = this.marks_[this.held_], xs = this.data_[0];
      if (x == null || xs.length < 2) return;
      const at = x + samples * (xs[xs.length - 1] - xs[0]) / (xs.length - 1), { min, max } = this.plot_.scales.x;
      this.marks_[this.held_] = Math.min(Math.max(at, min), max);
      this.table();
      this.plot_.redraw();
    },
    unmark() {
      this.marks_ = { a: null, b: null };
      this.rows = [];
      this.plot_?.redraw(false);
    },
    unzoom() {
      this.zoomed_ = false;
      if (this.plot_) this.plot_.setData(this.data_, true);
    },
    table() {
      const { a, b } = this.marks_;
      if (a == null && b == null) return;
      const xs = this.data_[0];
      const near = (x) => {
        if (x == null || !xs.length) return null;
        let lo = 0, hi = xs.length - 1;
        while (lo < hi) { const m = (lo + hi) >> 1; if (xs[m] < x) lo = m + 1; else hi = m; }
        return lo;
      };
      const ia = near(a), ib = near(b);
      const row = (name, va, vb, colour) => [name, nice(va), nice(vb), va == null || vb == null ? "–" : nice(vb - va), colour];
      this.rows = [row("time (s)", a, b, "transparent"), ...this.channels_.map((c, i) =>
        row(c.name, ia == null ? null : this.data_[i + 1][ia], ib == null ? null : this.data_[i + 1][ib], c.colour))];
    },
    key(e) {
      const way = { ArrowLeft: -1, ArrowRight: 1 }[e.key];
      if (e.key === "a") this.mark("a");
      else if (e.key === "b") this.mark("b");
      else if (way) this.step(way * (e.shiftKey ? 10 : 1));
      else if (e.key === "Delete") { this.unmark(); this.unzoom(); }
      else return;
      e.preventDefault();
    },
    png(title) {
      const u = this.plot_;
      if (!u) return;
      const from = u.ctx.canvas, r = devicePixelRatio, head = 30 * r;
      const to = document.createElement("canvas");
      to.width = from.width; to.height = from.height + head;
      const c = to.getContext("2d");
      c.fillStyle = this.colour("--card"); c.fillRect(0, 0, to.width, to.height);
      c.drawImage(from, 0, head);
      c.font = `${13 * r}px Roboto, sans-serif`;
      let x = 12 * r;
      c.fillStyle = this.colour("--ink"); c.fillText(title, x, 20 * r); x += c.measureText(title).width + 24 * r;
      for (const ch of this.channels_) {
        c.fillStyle = ch.colour; c.fillRect(x, 11 * r, 14 * r, 4 * r); x += 20 * r;
        c.fillStyle = this.colour("--ink"); c.fillText(ch.name, x, 20 * r); x += c.measureText(ch.name).width + 18 * r;
      }
      const link = document.createElement("a");
      link.download = "scope.png"; link.href = to.toDataURL("image/png"); link.click();
    },
  },
};
