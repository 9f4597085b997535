"use strict";
document.documentElement.classList.add("live");

const CLOSEST = 1, FARTHEST = 2000, STEP = 1.5, SHARE = 0.2, REACH_PX = 16, WIDE_PX = 36, HIGH_PX = 15,
      BAR_PX = 90, NICE = [5, 2, 1];

/** A picture that can be moved and magnified; its state maps the first view to the present one. */
class View {
  constructor(figure) {
    this.figure = figure;
    this.stage = figure.querySelector(".stage");
    this.svg = this.stage.querySelector("svg");
    this.moved = this.svg.querySelector(".move");
    this.width = this.svg.viewBox.baseVal.width;
    this.height = this.svg.viewBox.baseVal.height;
    this.fit();
    for (const button of figure.querySelectorAll("button[data-do]")) {
      button.addEventListener("click", () => this.act(button.dataset.do));
    }
    for (const box of figure.querySelectorAll("input[data-layer]")) {
      box.addEventListener("change", () => this.layers());
    }
    this.layers();
    this.stage.addEventListener("keydown", (event) => this.key(event));
    this.stage.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.stage.addEventListener("pointerdown", (event) => this.hold(event));
    this.stage.addEventListener("pointermove", (event) => this.drag(event));
    for (const end of ["pointerup", "pointercancel"]) {
      this.stage.addEventListener(end, () => this.release());
    }
    new ResizeObserver(() => this.place()).observe(this.svg);
  }

  /** Units of the picture per pixel of the screen. */
  get unit() { return this.width / (this.svg.clientWidth || this.width); }

  fit() { this.k = 1; this.x = 0; this.y = 0; this.place(); }

  move(dx, dy) { this.x += dx; this.y += dy; this.place(); }

  zoom(factor, x = this.width / 2, y = this.height / 2) {
    const k = Math.min(Math.max(this.k * factor, CLOSEST / 4), FARTHEST);
    this.x = x - (x - this.x) * k / this.k;
    this.y = y - (y - this.y) * k / this.k;
    this.k = k;
    this.place();
  }

  place() {
    this.moved.setAttribute("transform", `matrix(${this.k} 0 0 ${this.k} ${this.x} ${this.y})`);
    const taken = [];
    for (const label of this.svg.querySelectorAll("text[data-x]")) {
      const x = this.k * label.dataset.x + this.x + label.dataset.aside * this.unit;
      const place = this.k * label.dataset.y + this.y, border = HIGH_PX / 2 * this.unit;
      let y = place + label.dataset.below * this.unit;
      if (place > 0 && place < this.height) { y = Math.min(Math.max(y, border), this.height - border); }
      label.setAttribute("x", x);
      label.setAttribute("y", y);
      const free = taken.every(([u, v]) => Math.abs(u - x) > WIDE_PX * this.unit || Math.abs(v - y) > HIGH_PX * this.unit);
      label.toggleAttribute("hidden", !free);
      if (free) { taken.push([x, y]); }
    }
  }

  layers() {
    const shown = {};
    for (const box of this.figure.querySelectorAll("input[data-layer]")) { shown[box.dataset.layer] = box.checked; }
    for (const part of this.svg.querySelectorAll("[data-of]")) {
      part.toggleAttribute("hidden", !part.dataset.of.split(" ").some((key) => shown[key]));
    }
  }

  act(what) {
    const dx = SHARE * this.width, dy = SHARE * this.height;
    const acts = {
      in: () => this.zoom(STEP), out: () => this.zoom(1 / STEP), fit: () => this.fit(),
      left: () => this.move(dx, 0), right: () => this.move(-dx, 0), up: () => this.move(0, dy), down: () => this.move(0, -dy),
      before: () => this.step(-1), after: () => this.step(1),
    };
    acts[what]();
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) { return; }
    const keys = { ArrowLeft: "left", ArrowRight: "right", ArrowUp: "up", ArrowDown: "down", "+": "in", "=": "in",
                   "-": "out", "0": "fit", PageUp: "before", PageDown: "after" };
    if (keys[event.key]) { event.preventDefault(); this.act(keys[event.key]); }
  }

  /** Magnify where the pointer is, but leave the wheel to the page until someone has turned to the picture. */
  wheel(event) {
    if (!event.ctrlKey && document.activeElement !== this.stage) { return; }
    event.preventDefault();
    this.zoom(event.deltaY < 0 ? STEP : 1 / STEP, ...this.at(event));
  }

  at(event) {
    const box = this.svg.getBoundingClientRect();
    return [(event.clientX - box.left) * this.unit, (event.clientY - box.top) * this.unit];
  }

  hold(event) {
    if (event.button !== 0) { return; }
    this.held = this.at(event);
    this.stage.classList.add("held");
    this.stage.setPointerCapture(event.pointerId);
  }

  drag(event) {
    const [x, y] = this.at(event);
    if (!this.held) { this.point(event, x, y); return; }
    this.move(x - this.held[0], y - this.held[1]);
    this.held = [x, y];
  }

  release() { this.held = null; this.stage.classList.remove("held"); }

  point() {}

  say(text) { this.figure.querySelector("figcaption [data-caption], figcaption[data-caption]").textContent = text; }
}

/** Images of one camera, one of which is shown. */
class Photo extends View {
  constructor(figure) {
    super(figure);
    this.range = figure.querySelector("input[type=range]");
    this.range.addEventListener("input", () => this.show(+this.range.value));
    this.show(+this.range.value);
  }

  step(by) {
    const count = +this.range.max;
    this.show((+this.range.value - 1 + by + count) % count + 1);
  }

  show(number) {
    this.range.value = number;
    for (const part of this.svg.querySelectorAll("[data-shot]")) {
      part.toggleAttribute("hidden", +part.dataset.shot !== number);
    }
    const said = this.svg.querySelector(`g[data-shot="${number}"]`).dataset.caption;
    this.range.setAttribute("aria-valuetext", said);
    this.say(said);
  }
}

/** The map: a scale bar that follows, and words about what is under the pointer. */
class Plan extends View {
  constructor(figure) {
    super(figure);
    this.moments = JSON.parse(figure.dataset.moments);
    this.number = -1;
    this.tip = this.stage.querySelector(".tip");
    this.stage.addEventListener("pointerleave", () => { this.tip.hidden = true; });
  }

  place() {
    super.place();
    const scale = this.figure.dataset.scale * this.k, most = Math.max(this.width / 5, BAR_PX * this.unit) / scale;
    const power = 10 ** Math.floor(Math.log10(most));
    const metres = NICE.find((step) => step * power <= most) * power;
    const [x, y, long] = [20, this.height - 14, metres * scale];
    this.svg.querySelector(".bar path").setAttribute("d", `M${x} ${y - 6}V${y}H${x + long}V${y - 6}`);
    const text = this.svg.querySelector(".bar text");
    text.setAttribute("x", x + long / 2);
    text.setAttribute("y", y - 14 * this.unit);
    text.textContent = metres >= 1 ? `${metres} m` : `${+(100 * metres).toPrecision(2)} cm`;
    if (this.moments) { this.ring(); }
  }

  step(by) {
    const count = this.moments.length;
    if (!count) { return; }
    this.number = this.number < 0 ? (by > 0 ? 0 : count - 1) : (this.number + by + count) % count;
    this.ring();
    this.say(this.moments[this.number][2]);
  }

  ring() {
    const here = this.svg.querySelector(".here");
    if (this.number < 0) { here.setAttribute("d", ""); return; }
    const [x, y] = this.moments[this.number], r = 9 * this.unit;
    const turn = `a${r} ${r} 0 1 0`;
    here.setAttribute("d", `M${this.k * x + this.x - r} ${this.k * y + this.y}${turn} ${2 * r} 0${turn} ${-2 * r} 0Z`);
  }

  point(event, x, y) {
    const said = this.near(x, y) || this.under(event);
    this.tip.hidden = !said;
    if (!said) { return; }
    this.tip.textContent = said;
    const box = this.stage.getBoundingClientRect();
    const right = event.clientX - box.left > box.width / 2, low = event.clientY - box.top > box.height / 2;
    this.tip.style.left = right ? "" : `${event.clientX - box.left + 14}px`;
    this.tip.style.right = right ? `${box.right - event.clientX + 14}px` : "";
    this.tip.style.top = low ? "" : `${event.clientY - box.top + 14}px`;
    this.tip.style.bottom = low ? `${box.bottom - event.clientY + 14}px` : "";
  }

  near(x, y) {
    if (this.svg.querySelector('[data-of="seen"][hidden]')) { return ""; }
    let best = REACH_PX * this.unit, said = "";
    for (const [mx, my, text] of this.moments) {
      const far = Math.hypot(this.k * mx + this.x - x, this.k * my + this.y - y);
      if (far < best) { best = far; said = text; }
    }
    return said;
  }

  /** Look for lines a few pixels around, as no hand is steadier. */
  under(event) {
    for (const [dx, dy] of [[0, 0], [5, 0], [-5, 0], [0, 5], [0, -5]]) {
      const hit = document.elementFromPoint(event.clientX + dx, event.clientY + dy);
      const said = hit && hit.closest("[data-tip]");
      if (said && this.svg.contains(said)) { return said.dataset.tip; }
    }
    return "";
  }
}

for (const svg of document.querySelectorAll("svg.scaled")) {
  new ResizeObserver(() => {
    if (svg.clientWidth) { svg.style.setProperty("--u", svg.viewBox.baseVal.width / svg.clientWidth); }
  }).observe(svg);
}
/** What must be scrolled to be read must be reached by keys too. */
for (const part of document.querySelectorAll(".scroll")) {
  new ResizeObserver(() => {
    const cut = part.scrollWidth > part.clientWidth;
    for (const [name, value] of [["tabindex", "0"], ["role", "region"], ["aria-label", part.querySelector("caption").textContent]]) {
      if (cut) { part.setAttribute(name, value); } else { part.removeAttribute(name); }
    }
  }).observe(part);
}
for (const figure of document.querySelectorAll("figure.photo")) { new Photo(figure); }
for (const figure of document.querySelectorAll("figure.map")) { new Plan(figure); }

/** Copy a transform; where the browser does not let us, select it for the keys that always can. */
async function copy(button) {
  const source = document.querySelector(`pre[data-name="${button.dataset.copy}"]`);
  const status = button.parentElement.querySelector("[role=status]");
  try {
    await navigator.clipboard.writeText(source.textContent);
    status.textContent = "Copied.";
  } catch {
    getSelection().selectAllChildren(source);
    status.textContent = "Selected; copy it with Ctrl+C.";
  }
}
for (const button of document.querySelectorAll("button[data-copy]")) {
  button.addEventListener("click", () => copy(button));
}

const closed = [];
addEventListener("beforeprint", () => {
  for (const details of document.querySelectorAll("details:not([open])")) { details.open = true; closed.push(details); }
});
addEventListener("afterprint", () => { while (closed.length) { closed.pop().open = false; } });
