#include <algorithm>
#include <vector>

#include "core/parallel.h"
#include "cpu/triangle_ids.h"
#include "ops/raster.h"

namespace mipbake {
namespace {

using Index = std::int64_t;

// An edge of a triangle, listed under the smaller of its vertices.
struct ListedEdge {
    std::int32_t larger, edge;
    bool operator<(const ListedEdge& other) const {
        return larger != other.larger ? larger < other.larger : edge < other.edge;
    }
};

// Joins the edges of one smaller vertex that have the same larger one into cycles, in increasing order.
void join(ListedEdge* begin, ListedEdge* end, std::int32_t* next) {
    if (end - begin > 16) {
        std::sort(begin, end);
    } else {
        for (ListedEdge* i = begin; i < end; ++i) {  // an insertion sort, and stable: the edges come in order
            const ListedEdge edge = *i;
            ListedEdge* place = i;
            for (; place > begin && edge.larger < place[-1].larger; --place) *place = place[-1];
            *place = edge;
        }
    }
    for (ListedEdge* i = begin; i < end;) {
        ListedEdge* const first = i;
        for (; i + 1 < end && i[1].larger == first->larger; ++i) next[i->edge] = i[1].edge;
        next[i->edge] = first->edge;
        ++i;
    }
}

}  // namespace

void antialias_topology_cpu(const std::int32_t* tri, Index triangles, Index vertices, std::int32_t* next) {
    // A counting sort by the smaller vertex.
    std::vector<std::int32_t> first(static_cast<std::size_t>(vertices) + 2);
    const auto count = static_cast<std::uint64_t>(vertices);
    for (Index t = 0; t < triangles; ++t) {
        const std::int32_t a = tri[3 * t], b = tri[3 * t + 1], c = tri[3 * t + 2];
        if (std::uint64_t(a) >= count || std::uint64_t(b) >= count || std::uint64_t(c) >= count)
            return check_triangle_vertices(tri, triangles, vertices);
        ++first[static_cast<std::size_t>(std::min(a, b)) + 2];
        ++first[static_cast<std::size_t>(std::min(b, c)) + 2];
        ++first[static_cast<std::size_t>(std::min(c, a)) + 2];
    }
    for (std::size_t v = 2; v < first.size(); ++v) first[v] += first[v - 1];
    std::vector<ListedEdge> edges(static_cast<std::size_t>(3 * triangles));
    for (Index t = 0; t < triangles; ++t)
        for (int e = 0; e < 3; ++e) {
            const std::int32_t a = tri[3 * t + e], b = tri[3 * t + (e == 2 ? 0 : e + 1)];
            std::int32_t& place = first[static_cast<std::size_t>(std::min(a, b)) + 1];
            edges[static_cast<std::size_t>(place++)] = {std::max(a, b), static_cast<std::int32_t>(3 * t + e)};
        }
    parallel_for(vertices, 4096, [&](Index begin, Index end) {
        for (Index v = begin; v < end; ++v)
            join(edges.data() + first[static_cast<std::size_t>(v)],
                 edges.data() + first[static_cast<std::size_t>(v) + 1], next);
    });
}

}  // namespace mipbake
