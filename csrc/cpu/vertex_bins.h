// Sums over pixels into the vertices of the triangles that the pixels show, reproducible bit for bit whatever the
// number of threads: the backward passes of rasterisation, interpolation and antialiasing.
//
// The image is cut into tiles. A kernel adds the contributions of a tile's pixels to sums of its own, one per vertex
// that the tile meets, found through a small hash table: pixels are read in the order of memory, whatever the order of
// the mesh, and a vertex that many pixels share costs one sum per tile. The tiles' sums are then sorted by bins of
// vertices (core/bins.h), and added in the order of the tiles.
//
//     sum_into_vertices<double>(grid, vertices, shared, channels, grad, [&](const PixelTile& tile, TileSums<double>& s)
//     {
//         for each pixel of the tile that shows triangle t:
//             const std::uint16_t* slots = corners_of(s, tri, t);   // keep it while the triangle stays the same
//             double* g = sums_of(s, slots[k]);                     // `channels` sums for corner k = 0, 1, 2
//         or, without a triangle: sums_of(s, slot_of(s, vertex))
//     });
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <memory>
#include <utility>
#include <vector>

#include "core/bins.h"
#include "core/mutex.h"
#include "core/platform.h"

namespace mipbake {

constexpr int kTileSide = 32;  // pixels
constexpr int kTileTriangles = kTileSide * kTileSide;
constexpr int kPixelVertices = 4;  // that a pixel contributes to, at most
constexpr int kTileVertices = kPixelVertices * kTileTriangles;
constexpr int kTriangleTable = 2 * kTileTriangles, kVertexTable = 8192;
constexpr std::uint16_t kNoSlot = 0xffff;

struct PixelGrid {
    std::int64_t batch;
    int height, width;
};

// Rows [y0, y1) and columns [x0, x1) of a batch item.
struct PixelTile {
    std::int64_t item;
    int y0, y1, x0, x1;
};

struct TileTables {
    std::uint16_t of_triangle[kTriangleTable], of_vertex[kVertexTable];
    std::int32_t triangles[kTileTriangles];
    std::uint16_t corners[kTileTriangles][3];
};

// Plain data, laid out alike in every instruction set.
template <class S>
struct TileSums {
    TileTables* tables;
    std::int32_t* vertices;  // of each slot
    S* sums;                 // `channels` of each slot
    int channels, triangle_count, vertex_count;
};

inline namespace MIPBAKE_ISA {

// The slot of a vertex, made with sums of zero where it is new. A tile has room for kPixelVertices per pixel.
template <class S>
MIPBAKE_FUNCTION std::uint16_t slot_of(TileSums<S>& tile, std::int32_t vertex) {
    std::uint32_t place = (static_cast<std::uint32_t>(vertex) * 2654435769u) >> 19;
    static_assert(kVertexTable == 1 << (32 - 19), "the hash has as many bits as the table");
    for (;; place = (place + 1) % kVertexTable) {
        const std::uint16_t slot = tile.tables->of_vertex[place];
        if (slot == kNoSlot) break;
        if (tile.vertices[slot] == vertex) return slot;
    }
    const int slot = tile.vertex_count++;
    tile.tables->of_vertex[place] = static_cast<std::uint16_t>(slot);
    tile.vertices[slot] = vertex;
    S* const sums = tile.sums + static_cast<std::int64_t>(slot) * tile.channels;
    for (int c = 0; c < tile.channels; ++c) sums[c] = S(0);
    return static_cast<std::uint16_t>(slot);
}

template <class S>
MIPBAKE_INLINE S* sums_of(TileSums<S>& tile, std::uint16_t slot) {
    return tile.sums + static_cast<std::int64_t>(slot) * tile.channels;
}

// The index of a triangle among the triangles of the tile, numbered as they come: 0, 1, ...; `triangle_count` grows
// where the triangle is new. Touches no vertex.
template <class S>
MIPBAKE_FUNCTION int index_of(TileSums<S>& tile, std::int32_t triangle) {
    std::uint32_t place = (static_cast<std::uint32_t>(triangle) * 2654435769u) >> 21;
    static_assert(kTriangleTable == 1 << (32 - 21), "the hash has as many bits as the table");
    for (;; place = (place + 1) % kTriangleTable) {
        const std::uint16_t index = tile.tables->of_triangle[place];
        if (index == kNoSlot) break;
        if (tile.tables->triangles[index] == triangle) return index;
    }
    const int index = tile.triangle_count++;
    tile.tables->of_triangle[place] = static_cast<std::uint16_t>(index);
    tile.tables->triangles[index] = triangle;
    return index;
}

// The slots of the three vertices of a triangle; tri is (T, 3).
template <class S>
MIPBAKE_FUNCTION const std::uint16_t* corners_of(TileSums<S>& tile, const std::int32_t* tri, std::int32_t triangle) {
    const int known = tile.triangle_count, index = index_of(tile, triangle);
    std::uint16_t* const corners = tile.tables->corners[index];
    if (index == known)
        for (int k = 0; k < 3; ++k) corners[k] = slot_of(tile, tri[3 * static_cast<std::int64_t>(triangle) + k]);
    return corners;
}

}  // namespace MIPBAKE_ISA

// Overwrites out, (batch, vertices, channels), or (vertices, channels) where `shared`, with the sums that
// kernel(const PixelTile&, TileSums<S>&) makes of every tile. The kernel runs in parallel and must not throw.
// Scratch: no more than kSumBytes, or the sums of 16 tiles where these are more; what has no sums in it is not touched.
constexpr std::int64_t kSumBytes = std::int64_t(64) << 20;

template <class S, class T, class Kernel>
void sum_into_vertices(const PixelGrid& grid, std::int64_t vertices, bool shared, int channels, T* out,
                       Kernel&& kernel) {
    using Index = std::int64_t;
    const Index rows = (grid.height + kTileSide - 1) / kTileSide, columns = (grid.width + kTileSide - 1) / kTileSide;
    const Index tiles = grid.batch * rows * columns, places = (shared ? 1 : grid.batch) * vertices;
    const Index room = Index(kPixelVertices) * std::min(kTileSide, grid.height) * std::min(kTileSide, grid.width);
    const Index per_tile = room * (channels * Index(sizeof(S)) + Index(sizeof(std::int32_t)));
    const Index round = std::max<Index>(
        1, std::min({tiles, Index(1) << 20, std::max<Index>(16, kSumBytes / std::max<Index>(1, per_tile))}));
    // What a kernel fills, for one tile at a time, and what is kept of it.
    struct Room {
        std::unique_ptr<S[]> sums;
        std::unique_ptr<std::int32_t[]> vertices;
    };
    struct Kept {
        Room room;
        Index size = 0;
    };
    const auto make_room = [&](Index size) {
        return Room{std::unique_ptr<S[]>(new S[static_cast<std::size_t>(size * channels)]),
                    std::unique_ptr<std::int32_t[]>(new std::int32_t[static_cast<std::size_t>(size)])};
    };
    std::vector<Room> rooms;
    Mutex rooms_lock;
    std::vector<Kept> kept(static_cast<std::size_t>(round));
    const auto sums_at = [&](Index entry) {
        return kept[static_cast<std::size_t>(entry / kTileVertices)].room.sums.get() + entry % kTileVertices * channels;
    };

    constexpr Index bin_values = 8192;  // 64 KiB of double
    const Index bin_size = std::max<Index>(1, bin_values / std::max(1, channels));
    const Index block = std::min<Index>(channels, bin_values);  // of channels at a time
    const Index bins = (places + bin_size - 1) / bin_size;
    const auto place_of = [&](Index tile, Index slot, Index first) {
        const Index item = shared ? 0 : (first + tile) / (rows * columns);
        return item * vertices + kept[static_cast<std::size_t>(tile)].room.vertices[static_cast<std::size_t>(slot)];
    };
    for (Index first = 0; first == 0 || first < tiles; first += round) {
        const Index count = std::min(round, tiles - first);  // 0 where there are no pixels: the result is zeros then
        parallel_for(count, 4, [&](Index begin, Index end) {
            TileTables tables;
            std::memset(tables.of_triangle, 0xff, sizeof tables.of_triangle);
            std::memset(tables.of_vertex, 0xff, sizeof tables.of_vertex);
            Room own;
            {
                const std::lock_guard<Mutex> lock(rooms_lock);
                if (!rooms.empty()) {
                    own = std::move(rooms.back());
                    rooms.pop_back();
                }
            }
            if (own.sums == nullptr) own = make_room(room);
            for (Index i = begin; i < end; ++i) {
                const Index tile = first + i, item = tile / (rows * columns);
                const int y = static_cast<int>(tile / columns % rows) * kTileSide;
                const int x = static_cast<int>(tile % columns) * kTileSide;
                const PixelTile pixels{item, y, std::min(grid.height, y + kTileSide), x,
                                       std::min(grid.width, x + kTileSide)};
                TileSums<S> filled{&tables, own.vertices.get(), own.sums.get(), channels, 0, 0};
                kernel(pixels, filled);
                Kept& target = kept[static_cast<std::size_t>(i)];
                target.size = filled.vertex_count;
                target.room = make_room(target.size);
                std::copy(filled.vertices, filled.vertices + target.size, target.room.vertices.get());
                std::copy(filled.sums, filled.sums + target.size * channels, target.room.sums.get());
                if (filled.triangle_count > 0) std::memset(tables.of_triangle, 0xff, sizeof tables.of_triangle);
                if (filled.vertex_count > 0) std::memset(tables.of_vertex, 0xff, sizeof tables.of_vertex);
            }
            const std::lock_guard<Mutex> lock(rooms_lock);
            rooms.push_back(std::move(own));
        });
        BinLimits limits;
        limits.items_per_sort = round;
        limits.items_per_chunk = 16;
        limits.chunks_per_sort = 32;
        for_each_bin(
            count, bins,
            [&](Index begin, Index end, std::uint32_t* sizes) {
                for (Index i = begin; i < end; ++i)
                    for (Index slot = 0; slot < kept[static_cast<std::size_t>(i)].size; ++slot)
                        ++sizes[place_of(i, slot, first) / bin_size];
            },
            [&](Index begin, Index end, std::uint32_t* cursors, std::uint32_t* list, Index) {
                for (Index i = begin; i < end; ++i)
                    for (Index slot = 0; slot < kept[static_cast<std::size_t>(i)].size; ++slot)
                        list[cursors[place_of(i, slot, first) / bin_size]++] =
                            static_cast<std::uint32_t>(i * kTileVertices + slot);
            },
            [&](Index bin, const std::uint32_t* list, Index size, Index) {
                const Index from = bin * bin_size, bin_places = std::min(bin_size, places - from);
                for (Index c0 = 0; c0 < channels; c0 += block) {
                    const Index width = std::min(block, channels - c0);
                    S totals[bin_values];
                    std::fill(totals, totals + bin_places * width, S(0));
                    for (Index k = 0; k < size; ++k) {
                        const Index entry = list[k];
                        const Index place = place_of(entry / kTileVertices, entry % kTileVertices, first) - from;
                        const S* const part = sums_at(entry) + c0;
                        for (Index c = 0; c < width; ++c) totals[place * width + c] += part[c];
                    }
                    for (Index place = 0; place < bin_places; ++place)
                        for (Index c = 0; c < width; ++c) {
                            T& target = out[(from + place) * channels + c0 + c];
                            target = static_cast<T>((first == 0 ? S(0) : static_cast<S>(target)) +
                                                    totals[place * width + c]);
                        }
                }
            },
            limits);
    }
}

}  // namespace mipbake
