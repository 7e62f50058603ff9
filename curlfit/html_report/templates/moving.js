"use strict";
document.documentElement.classList.add("js");
const moving = {}; // function that starts a part, by its kind

// Calls step(seconds) for every frame while running; with reduced motion, once a second.
function clock(step) {
  const calm = matchMedia("(prefers-reduced-motion: reduce)");
  let on = false, last = 0, timer = 0;
  function tick() {
    const now = performance.now();
    const passed = Math.min((now - last) / 1000, 1.5);
    last = now;
    step(passed);
    if (on) wait();
  }
  function wait() {
    if (calm.matches) timer = setTimeout(tick, 1000);
    else timer = requestAnimationFrame(tick);
  }
  return {
    get on() { return on; },
    start() {
      if (on) return;
      on = true;
      last = performance.now();
      wait();
    },
    stop() {
      on = false;
      clearTimeout(timer);
      cancelAnimationFrame(timer);
    },
  };
}

function parts(root) {
  return name => root.querySelector(`[data-part="${name}"]`);
}

// Space plays and pauses, except on elements that use it themselves.
function spaceToggles(root, toggle) {
  root.addEventListener("keydown", event => {
    const own = event.target.closest("button, select");
    if (event.key !== " " || own) return;
    event.preventDefault();
    toggle();
  });
}

// In print, animations are shown at their end.
function finishedInPrint(finish, resume) {
  addEventListener("beforeprint", finish);
  addEventListener("afterprint", resume);
}

// Announcements for screen readers, rate-limited to what a listener can follow.
function teller(element) {
  let last = 0;
  return (text, now) => {
    const time = performance.now();
    if (!now && time - last < 3000) return;
    last = time;
    element.textContent = text;
  };
}

// A line through points in a drawing of some height, with a gap where one is null.
function lineThrough(points, drawing, height) {
  let text = "", joined = "M";
  points[0].forEach((along, i) => {
    const across = points[1][i];
    if (along === null || across === null) { joined = "M"; return; }
    const u = drawing.margin + (along - drawing.origin[0]) * drawing.scale[0];
    const v = height - drawing.margin - (across - drawing.origin[1]) * drawing.scale[1];
    text += `${joined}${u.toFixed(4)} ${v.toFixed(4)}`;
    joined = "L";
  });
  return text;
}

function side(x) {
  return Math.abs(x) < 0.005 ? "on the centre line"
    : `${Math.abs(x).toFixed(2)} m ${x < 0 ? "left" : "right"} of the centre line`;
}

addEventListener("DOMContentLoaded", () => {
  const data = JSON.parse(document.getElementById("data").textContent);
  for (const [id, own] of Object.entries(data)) {
    const root = document.getElementById(id);
    if (root) moving[own.kind](root, own);
  }
});
