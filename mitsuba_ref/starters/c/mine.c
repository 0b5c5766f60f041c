/* A ray caster: every triangle, in double. cc -O2 -std=c99 -o mine mine.c -lm; mine MESH.raw RAYS.raw HITS.raw, or mine
   alone, for --candidate-serve */
#include "rays_and_hits.h"

static void cross(const double *a, const double *b, double *c) {
    for (int k = 0; k < 3; k++) c[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
}

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void cast(Mesh mesh, const Ray *rays, Hit *hits, size_t n) {
    for (size_t i = 0; i < n; i++) {
        double best = INFINITY, o[3], d[3];
        for (int k = 0; k < 3; k++) o[k] = rays[i].o[k], d[k] = rays[i].d[k];
        for (int64_t j = 0; j < mesh.faces; j++) {
            double c[3][3], e1[3], e2[3], normal[3], u[3], side[3]; /* corners as seen from o */
            for (int a = 0; a < 3; a++)
                for (int k = 0; k < 3; k++) c[a][k] = mesh.v[3 * mesh.f[3 * j + a] + k] - o[k];
            for (int k = 0; k < 3; k++) e1[k] = c[1][k] - c[0][k], e2[k] = c[2][k] - c[0][k];
            for (int a = 0; a < 3; a++) cross(c[a], c[(a + 1) % 3], u), side[a] = dot(u, d);
            int out = side[0] < 0 || side[1] < 0 || side[2] < 0, in = side[0] > 0 || side[1] > 0 || side[2] > 0;
            cross(e1, e2, normal);
            double slope = dot(normal, d), t = dot(normal, c[0]) / slope;
            if ((out && in) || slope == 0 || !(t > rays[i].t_min && t <= rays[i].t_max && t < best)) continue;
            best = t;
            double length = sqrt(dot(normal, normal));
            for (int k = 0; k < 3; k++) hits[i].n[k] = (float)(normal[k] / length);
            hits[i].prim = (float)j;
        }
        hits[i].t = (float)best;
    }
}

int main(int count, char **words) { return rh_main(count, words, cast); }
