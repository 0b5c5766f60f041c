import rh from "./rays_and_hits.js";
import * as THREE from "three";
import { MeshBVH } from "three-mesh-bvh";

rh.run((v, f) => {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(v, 3)).setIndex(new THREE.BufferAttribute(new Uint32Array(f), 1));
  const bvh = new MeshBVH(geometry, { indirect: true });
  return (o, d, tMin, tMax) => {
    const ray = new THREE.Ray(new THREE.Vector3(...o), new THREE.Vector3(...d)), length = Math.hypot(...d);
    const hit = bvh.raycastFirst(ray, THREE.DoubleSide, tMin * length, tMax * length);
    return hit && [hit.distance / length, ...hit.face.normal.toArray(), hit.faceIndex];
  };
});
