// Bullet 3.24: a ray beside a triangle hits it. g++ -I/usr/include/bullet bullet_edge.cpp -lBulletCollision -lLinearMath
#include <btBulletCollisionCommon.h>
#include <BulletCollision/NarrowPhaseCollision/btRaycastCallback.h>
#include <cstdio>
struct Hit : btTriangleRaycastCallback {
    bool hit = false;
    using btTriangleRaycastCallback::btTriangleRaycastCallback;
    btScalar reportHit(const btVector3 &, btScalar fraction, int, int) override { hit = true; return fraction; }
};
int main() {
    btVector3 triangle[3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    for (float beside : {1.0f / 4096, 1.0f / 16384, 0.0f}) {
        Hit found(btVector3(0.25f, -beside, 1), btVector3(0.25f, -beside, -1));
        found.processTriangle(triangle, 0, 0);
        std::printf("y %g: %s\n", 0 - beside, found.hit ? "a hit" : "a miss");
    }
}
