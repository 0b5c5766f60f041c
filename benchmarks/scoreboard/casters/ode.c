#include "rays_and_hits.h"
#include <ode/ode.h>

static void cast(Mesh m, const Ray *rays, Hit *hits, size_t n) {
    dInitODE();
    dTriMeshDataID data = dGeomTriMeshDataCreate();
    dGeomTriMeshDataBuildSingle(data, m.v, 12, m.vertices, m.f, 3 * m.faces, 12);
    dGeomID mesh = dCreateTriMesh(0, data, 0, 0, 0), ray = dCreateRay(0, 1);
    dGeomRaySetClosestHit(ray, 1);
    for (size_t i = 0; i < n; i++) {
        const float *o = rays[i].o, *d = rays[i].d;
        float far = 0;
        for (int64_t k = 0; k < 3 * m.vertices; k++) far = fmaxf(far, 4 * fabsf(m.v[k] - o[k % 3]));
        dContactGeom hit;
        dGeomRaySetLength(ray, far);
        dGeomRaySet(ray, o[0], o[1], o[2], d[0], d[1], d[2]);
        if (!dCollide(ray, mesh, 1, &hit, sizeof hit)) continue;
        float length = sqrt((double)d[0] * d[0] + (double)d[1] * d[1] + (double)d[2] * d[2]);
        hits[i] = (Hit){hit.depth / length, {hit.normal[0], hit.normal[1], hit.normal[2]}, hit.side2};
    }
    dGeomDestroy(mesh), dGeomDestroy(ray), dGeomTriMeshDataDestroy(data), dCloseODE();
}

int main(int count, char **words) { return rh_main(count, words, cast); }
