#include "rays_and_hits.h"
#include <embree3/rtcore.h>

static void cast(Mesh mesh, const Ray *rays, Hit *hits, size_t n) {
    RTCDevice device = rtcNewDevice(NULL);
    RTCScene scene = rtcNewScene(device);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    memcpy(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, mesh.vertices), mesh.v, 12 * mesh.vertices);
    memcpy(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, mesh.faces), mesh.f, 12 * mesh.faces);
    rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
    rtcCommitGeometry(geometry), rtcAttachGeometry(scene, geometry), rtcCommitScene(scene);
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    for (size_t i = 0; i < n; i++) {
        const Ray *r = &rays[i];
        struct RTCRayHit h = {{r->o[0], r->o[1], r->o[2], r->t_min, r->d[0], r->d[1], r->d[2], 0, r->t_max, -1, 0, 0}, {0}};
        h.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        rtcIntersect1(scene, &context, &h);
        if (h.hit.geomID != RTC_INVALID_GEOMETRY_ID) hits[i] = (Hit){h.ray.tfar, {h.hit.Ng_x, h.hit.Ng_y, h.hit.Ng_z}, (float)h.hit.primID};
    }
    rtcReleaseGeometry(geometry), rtcReleaseScene(scene), rtcReleaseDevice(device);
}

int main(int count, char **words) { return rh_main(count, words, cast); }
