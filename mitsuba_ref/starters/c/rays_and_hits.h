/* Rays in, hits out: {mesh}, {rays} and {hits} as files, or over stdin and stdout (--candidate-serve). C99, little-endian machines, no dependency. */
#ifndef RAYS_AND_HITS_H
#define RAYS_AND_HITS_H
#include <math.h>
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

static Mesh rh_mesh(char *data) {
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

/* --candidate-serve: the next block of a request, NULL at the end of stdin; free() it. */
static void *rh_block(size_t *size) {
    int64_t length;
    void *data;
    if (fread(&length, 8, 1, stdin) != 1) return NULL;
    *size = (size_t)length;
    data = malloc(*size ? *size : 1);
    if (data && fread(data, 1, *size, stdin) == *size) return data;
    exit(1);
}

static void rh_respond(const Hit *hits, size_t count) {
    int64_t length = (int64_t)(count * sizeof(Hit));
    if (fwrite(&length, 8, 1, stdout) != 1 || fwrite(hits, sizeof(Hit), count, stdout) != count || fflush(stdout)) exit(1);
}

/* main() of a caster: both ways. cast fills n hits; all of them are misses when it is called. */
static int rh_main(int count, char **words, void (*cast)(Mesh, const Ray *, Hit *, size_t)) {
    if (count != 1 && count != 4) return fprintf(stderr, "expected MESH.raw RAYS.raw HITS.raw, or nothing\n"), 2;
    for (;;) {
        size_t size, n;
        char *mesh = (char *)(count == 4 ? rh_read(words[1], &size) : rh_block(&size));
        if (!mesh) return 0;
        Ray *rays = (Ray *)(count == 4 ? rh_read(words[2], &size) : rh_block(&size));
        if (!rays) return 1;
        n = size / sizeof(Ray);
        Hit *hits = (Hit *)calloc(n ? n : 1, sizeof(Hit));
        for (size_t i = 0; i < n; i++) hits[i].t = INFINITY, hits[i].prim = -1;
        cast(rh_mesh(mesh), rays, hits, n);
        if (count == 4) rh_write(words[3], hits, n); else rh_respond(hits, n);
        free(hits), free(rays), free(mesh);
        if (count == 4) return 0;
    }
}
#endif
