// Follow a throw with the exported stone: vx, vy, omega and the length of a step.
import { accelerations, step } from "./curlfit_stone.mjs";
const [vx, vy, omega, dt] = process.argv.slice(2).map(Number);
const s = { x: 0.3, y: 1, vx, vy, phi: 0, omega };
const a = accelerations(0.7, omega);
while (step(s, dt));
console.log(...a, s.x, s.y, s.phi, Math.abs(s.vx) + Math.abs(s.vy) + Math.abs(s.omega));
