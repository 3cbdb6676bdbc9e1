"use strict";
// Moves the robots over the map, and a line over everything that has a time axis.
for (const shown of document.querySelectorAll(".shown")) {
  const map = shown.querySelector(".map");
  if (!map) continue;
  const ride = JSON.parse(shown.querySelector(".replay").textContent);
  const robots = ride.robots.map((robot) => ({ ...robot, shape: map.querySelector(`[data-index="${robot.index}"]`) }));
  const controls = shown.querySelector(".controls");
  const [play, slider, speed, output] = ["button", "input", "select", "output"].map((n) => controls.querySelector(n));
  const states = shown.querySelector(".states");
  const frames = [...shown.querySelectorAll("figure")];
  const cursors = shown.querySelectorAll(".cursor");
  const lines = robots.map((robot) => {
    const line = document.createElement("li");
    line.className = `r${robot.index % 6}`;
    states.append(line);
    return line;
  });
  const smallest = 7; // radius of a robot in pixels, or it is lost on a small screen
  let now = ride.end, last = null;

  function draw() {
    const k = Math.max(0, (now - ride.start) / ride.step);
    const pixels = map.clientWidth / map.viewBox.baseVal.width;
    const size = Math.max(1, smallest / (0.22 * Math.max(pixels, 1e-6)));
    robots.forEach((robot, i) => {
      const a = Math.min(Math.floor(k), robot.x.length - 1), b = Math.min(a + 1, robot.x.length - 1);
      const f = Math.min(k - a, 1);
      const at = (values) => values[a] + f * (values[b] - values[a]);
      robot.shape.setAttribute("transform",
        `translate(${at(robot.x)} ${at(robot.y)}) rotate(${at(robot.a)}) scale(${size})`);
      const state = robot.states.filter(([stamp]) => stamp <= now).pop();
      lines[i].textContent = `${robot.name}: ${state ? state[1] : "–"}`;
    });
    const percent = 100 * (now - ride.start) / Math.max(ride.end - ride.start, 1e-9);
    cursors.forEach((cursor) => { cursor.style.left = `${percent}%`; });
    slider.value = 10 * percent;
    output.textContent = `${now.toFixed(1)} s`;
    const past = frames.filter((frame) => Number(frame.dataset.stamp) <= now);
    frames.forEach((frame) => frame.classList.toggle("now", now < ride.end && frame === past[past.length - 1]));
    shown.classList.toggle("replaying", now < ride.end);
  }

  function tick(wall) {
    if (last === null) return;
    now = Math.min(ride.end, now + Number(speed.value) * (wall - last) / 1000);
    last = wall;
    draw();
    if (now >= ride.end) pause();
    else requestAnimationFrame(tick);
  }

  function pause() { last = null; play.textContent = "▶"; }

  function jump(to) { now = Math.min(ride.end, Math.max(ride.start, to)); draw(); }

  play.addEventListener("click", () => {
    if (last !== null) { pause(); return; }
    if (now >= ride.end) now = ride.start;
    play.textContent = "❚❚";
    last = performance.now();
    requestAnimationFrame(tick);
  });
  slider.addEventListener("input", () => jump(ride.start + slider.value / 1000 * (ride.end - ride.start)));
  frames.forEach((frame) => frame.addEventListener("click", () => jump(Number(frame.dataset.stamp))));
  shown.querySelectorAll(".row:not(.axis) .time").forEach((time) => time.addEventListener("click", (event) => {
    const box = time.getBoundingClientRect();
    jump(ride.start + (event.clientX - box.left) / box.width * (ride.end - ride.start));
  }));
  window.addEventListener("resize", draw);
  controls.hidden = false;
  draw();
}
