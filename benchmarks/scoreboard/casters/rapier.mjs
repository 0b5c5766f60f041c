import rh from "./rays_and_hits.js";
import RAPIER from "@dimforge/rapier3d-compat";

await RAPIER.init();
rh.run((v, f) => {
  const world = new RAPIER.World({ x: 0, y: 0, z: 0 });
  world.createCollider(RAPIER.ColliderDesc.trimesh(v, new Uint32Array(f)));
  world.step();
  return ([x, y, z], [a, b, c]) => {
    const hit = world.castRayAndGetNormal(new RAPIER.Ray({ x, y, z }, { x: a, y: b, z: c }), 1e9, true);
    return hit && [hit.timeOfImpact, hit.normal.x, hit.normal.y, hit.normal.z, hit.featureId];
  };
});
