// @dimforge/rapier3d-compat 0.21.0: a ray to the middle of an edge that two triangles share misses both. Needs that package alone.
import RAPIER from "@dimforge/rapier3d-compat";

await RAPIER.init();
const a = [0.376953125, -0.8505859375, 0.564453125], b = [-0.119140625, -0.4375, -0.3076171875], o = [0.28515625, -0.9560546875, -0.6982421875];
const v = [a, b, [0.4794921875, 0.822265625, -0.8408203125], [-0.96875, -0.5791015625, 0.9375]].flat();
const world = new RAPIER.World({ x: 0, y: 0, z: 0 });
world.createCollider(RAPIER.ColliderDesc.trimesh(new Float32Array(v), new Uint32Array([0, 1, 2, 1, 0, 3])));
world.step();
const [x, y, z] = a.map((x, i) => (x + b[i]) / 2 - o[i]); // exact, in float32 as well
const hit = world.castRay(new RAPIER.Ray({ x: o[0], y: o[1], z: o[2] }, { x, y, z }), 9, true);
console.log(hit ? `hit at t ${hit.timeOfImpact}` : "MISSED: both triangles are at t = 1");
