#include "rays_and_hits.h"
#include <btBulletCollisionCommon.h>

static void cast(Mesh m, const Ray *rays, Hit *hits, size_t n) {
    btTriangleIndexVertexArray arrays(m.faces, m.f, 12, m.vertices, (btScalar *)m.v, 12);
    btBvhTriangleMeshShape shape(&arrays, true);
    btCollisionObject object;
    object.setCollisionShape(&shape);
    for (size_t i = 0; i < n; i++) {
        float far = 0;
        for (int64_t k = 0; k < 3 * m.vertices; k++) far = fmaxf(far, 4 * fabsf(m.v[k] - rays[i].o[k % 3]));
        btVector3 o(rays[i].o[0], rays[i].o[1], rays[i].o[2]), d(rays[i].d[0], rays[i].d[1], rays[i].d[2]);
        btTransform from(btQuaternion::getIdentity(), o), to(btQuaternion::getIdentity(), o + far * d);
        btCollisionWorld::ClosestRayResultCallback hit(from.getOrigin(), to.getOrigin());
        btCollisionWorld::rayTestSingle(from, to, &object, &shape, object.getWorldTransform(), hit);
        const btVector3 &normal = hit.m_hitNormalWorld;
        if (hit.hasHit()) hits[i] = {far * hit.m_closestHitFraction, {normal[0], normal[1], normal[2]}, -1};
    }
}

int main(int count, char **words) { return rh_main(count, words, cast); }
