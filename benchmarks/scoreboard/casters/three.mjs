import rh from "./rays_and_hits.js";
import * as THREE from "three";

rh.run((v, f) => {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(v, 3)).setIndex(new THREE.BufferAttribute(new Uint32Array(f), 1));
  const mesh = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ side: THREE.DoubleSide }));
  const caster = new THREE.Raycaster();
  return (o, d, tMin, tMax) => {
    const length = Math.hypot(...d); // a Raycaster expects directions of length 1
    caster.set(new THREE.Vector3(...o), new THREE.Vector3(...d).divideScalar(length));
    [caster.near, caster.far] = [tMin * length, tMax * length];
    const hit = caster.intersectObject(mesh)[0];
    return hit && [hit.distance / length, ...hit.face.normal.toArray(), hit.faceIndex];
  };
});
