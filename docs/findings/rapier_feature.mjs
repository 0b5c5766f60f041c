// @dimforge/rapier3d-compat 0.21.0: featureId of a hit on a triangle mesh does not say which triangle. Needs that package alone.
import RAPIER from "@dimforge/rapier3d-compat";

await RAPIER.init();
const world = new RAPIER.World({ x: 0, y: 0, z: 0 }), places = [0, 2, 4, 6];
const v = places.flatMap((x) => [x, 0, 0, x + 1, 0, 0, x, 1, 0]), f = places.flatMap((_, i) => [3 * i, 3 * i + 1, 3 * i + 2]);
world.createCollider(RAPIER.ColliderDesc.trimesh(new Float32Array(v), new Uint32Array(f)));
world.step();
places.forEach((x, i) => {
  const ray = new RAPIER.Ray({ x: x + 0.25, y: 0.25, z: 1 }, { x: 0, y: 0, z: -1 });
  console.log(`face ${i}: featureId ${world.castRayAndGetNormal(ray, 9, true).featureId}`);
});
