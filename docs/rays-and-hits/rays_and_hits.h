/* Rays in, hits out: reads {rays.raw} and {mesh.raw}, writes {hits.raw}. C99, little-endian machines, no dependency. */
#ifndef RAYS_AND_HITS_H
#define RAYS_AND_HITS_H
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct { float o[3], d[3], t_min, t_max; } Ray;                /* a hit has t_min < t <= t_max */
typedef struct { float t, n[3], prim; } Hit;                           /* t INFINITY on a miss, in lengths of d */
typedef struct { int64_t vertices, faces; float *v; int32_t *f; } Mesh; /* v: 3 a vertex; f: 3 indices a face */

static void *rh_read(const char *path, size_t *size) {
    FILE *file = fopen(path, "rb");
    void *data = NULL;
    if (file && !fseek(file, 0, SEEK_END)) {
        *size = (size_t)ftell(file);
        rewind(file);
        data = malloc(*size ? *size : 1);
        if (data && fread(data, 1, *size, file) != *size) { free(data); data = NULL; }
    }
    if (file) fclose(file);
    if (!data) { fprintf(stderr, "%s: cannot be read\n", path); exit(1); }
    return data;
}

static Ray *rh_rays(const char *path, size_t *count) {
    size_t size;
    Ray *rays = rh_read(path, &size);
    *count = size / sizeof(Ray);
    return rays;
}

static Mesh rh_mesh(const char *path) {
    size_t size;
    char *data = rh_read(path, &size);
    Mesh mesh;
    memcpy(&mesh, data, 16);
    mesh.v = (float *)(data + 16);
    mesh.f = (int32_t *)(mesh.v + 3 * mesh.vertices);
    return mesh;
}

static void rh_write(const char *path, const Hit *hits, size_t count) {
    FILE *file = fopen(path, "wb");
    if (!file || fwrite(hits, sizeof(Hit), count, file) != count || fclose(file)) {
        fprintf(stderr, "%s: cannot be written\n", path);
        exit(1);
    }
}
#endif
