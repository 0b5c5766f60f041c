#include "rays_and_hits.h"
#include <CGAL/AABB_traits.h>
#include <CGAL/AABB_tree.h>
#include <CGAL/AABB_triangle_primitive.h>
#include <CGAL/Simple_cartesian.h>
using K = CGAL::Simple_cartesian<double>;
using Faces = std::vector<K::Triangle_3>;
using Tree = CGAL::AABB_tree<CGAL::AABB_traits<K, CGAL::AABB_triangle_primitive<K, Faces::const_iterator>>>;

static void cast(Mesh m, const Ray *rays, Hit *hits, size_t n) {
    auto corner = [&](int64_t k) { float *p = m.v + 3 * m.f[k]; return K::Point_3(p[0], p[1], p[2]); };
    Faces faces;
    for (int64_t j = 0; j < m.faces; j++) faces.emplace_back(corner(3 * j), corner(3 * j + 1), corner(3 * j + 2));
    Tree tree;
    for (auto f = faces.cbegin(); f != faces.cend(); f++) if (!f->is_degenerate()) tree.insert(f); // a precondition
    for (size_t i = 0; i < n; i++) {
        K::Point_3 o(rays[i].o[0], rays[i].o[1], rays[i].o[2]);
        K::Vector_3 d(rays[i].d[0], rays[i].d[1], rays[i].d[2]);
        auto found = tree.first_intersection(K::Ray_3(o, d));
        const K::Point_3 *p = found ? boost::get<K::Point_3>(&found->first) : nullptr;
        if (!p) continue;
        auto a = found->second->supporting_plane().orthogonal_vector();
        hits[i] = {float((*p - o) * d / (d * d)), {float(a.x()), float(a.y()), float(a.z())}, float(found->second - faces.cbegin())};
    }
}
int main(int count, char **words) { return rh_main(count, words, cast); }
