#include "cpu/network.h"

#include <algorithm>
#include <memory>
#include <mutex>
#include <vector>

#include "core/parallel.h"
#include "cpu/network_weights.h"

// A bake goes down the image in bands of rows. Of each band the rows of latents that its filters reach are encoded into
// a ring of rows; level 0 is filtered and decoded; and the band is added to the rows of coarser images that it is a
// part of. A row of these that has got all its parts is filtered across, and decoded, or handed on to images that are
// coarser still. Every sum runs in the order of the rows.

namespace mipbake {

using Index = std::int64_t;

namespace {

// Columns that one thread adds up at a time. A guess.
constexpr Index kColumns = 256;

// Which rows a row of the finer image is a part of.
struct Part {
    int row;
    float sharp, plain;
};

struct Row {
    Index index;
    const float* planes;
};

}  // namespace

struct NetworkBake::State {
    struct Sink {
        NetworkSink args;
        std::vector<float> bias;
        Index width;  // of the finer image
        bool decoded, feeds;
        std::vector<std::vector<Part>> parts;  // by row of the finer image
        std::vector<int> left;                 // parts that a row waits for
        std::vector<int> slot, free;           // memory of rows that have begun, and of none
        std::vector<Floats> sums;
        Index plane;
    };

    std::shared_ptr<const Network> network;
    NetworkBakeArgs args;
    std::vector<Sink> sinks;
    std::vector<float> bias;
    Index latents, plane, ring_rows, encoded, done = 0;
    std::vector<Floats> ring;
    Floats transposed;
    Index texel;  // floats from texel to texel of `transposed`
    std::mutex lending;
    std::vector<std::unique_ptr<Floats>> scratch;
    Index scratch_floats;

    State(std::shared_ptr<const Network> given, const NetworkBakeArgs& a)
        : network(std::move(given)), args(a), bias(network->padded(a.bias)) {
        const KernelNetwork& net = network->kernel;
        latents = net.moments + net.learned;
        plane = rounded_up(args.width + 2 * args.reach, kSlack) + kTile + 2 * kSlack;
        ring_rows = kBand + 2 * args.reach;
        encoded = -args.reach;
        for (Index i = 0; i < ring_rows; ++i) ring.emplace_back(latents * plane + kSlack);
        texel = rounded_up(latents + net.detail, kSlack);
        transposed = Floats(args.width * texel + kSlack);
        scratch_floats = std::max(MIPBAKE_DISPATCH(network_encode_scratch)(net),
                                  MIPBAKE_DISPATCH(network_decode_scratch)(net, args.reach));
        for (int i = 0; i < num_threads(); ++i) scratch.push_back(std::make_unique<Floats>(scratch_floats));
        for (int i = 0; i < args.sink_count; ++i) {
            sinks.push_back(sink(args.sinks[i]));
            const int source = args.sinks[i].source;
            if (source >= 0) sinks[static_cast<std::size_t>(source)].feeds = true;
        }
    }

    Sink sink(const NetworkSink& given) const {
        const bool decoded = given.out != nullptr;
        const Index width =
            given.source < 0 ? args.width : sinks[static_cast<std::size_t>(given.source)].args.columns.n;
        const Index height = given.source < 0 ? args.height : sinks[static_cast<std::size_t>(given.source)].args.rows.n;
        Sink out = {given, decoded ? network->padded(given.bias) : std::vector<float>(),
                    width, decoded,
                    false, {},
                    {},    {},
                    {},    {},
                    0};
        out.parts.resize(static_cast<std::size_t>(height));
        out.left.resize(static_cast<std::size_t>(given.rows.n));
        out.slot.assign(static_cast<std::size_t>(given.rows.n), -1);
        out.plane = rounded_up(width, kSlack) + kSlack;
        for (int row = 0; row < given.rows.n; ++row)
            for (int tap = 0; tap < given.rows.taps; ++tap) {
                const Index at = static_cast<Index>(row) * given.rows.taps + tap;
                auto& parts = out.parts[static_cast<std::size_t>(given.rows.index[at])];
                if (!parts.empty() && parts.back().row == row) {  // where many taps are one row
                    parts.back().sharp += given.rows.sharp[at];
                    parts.back().plain += given.rows.plain[at];
                    continue;
                }
                parts.push_back({row, given.rows.sharp[at], given.rows.plain[at]});
                ++out.left[static_cast<std::size_t>(row)];
            }
        return out;
    }

    // Calls f(scratch) with memory that no other thread uses meanwhile.
    template <class F>
    void with_scratch(F&& f) {
        std::unique_ptr<Floats> lent;
        {
            const std::lock_guard<std::mutex> lock(lending);
            if (!scratch.empty()) {
                lent = std::move(scratch.back());
                scratch.pop_back();
            }
        }
        if (lent == nullptr) lent = std::make_unique<Floats>(scratch_floats);
        f(lent->data());
        const std::lock_guard<std::mutex> lock(lending);
        scratch.push_back(std::move(lent));
    }

    Index placed(Index at, Index size, bool wrap) const {
        if (!wrap) return std::clamp<Index>(at, 0, size - 1);
        const Index rest = at % size;
        return rest < 0 ? rest + size : rest;
    }

    float* ring_row(Index row) const {
        const Index at = (row + args.reach) % ring_rows;
        return ring[static_cast<std::size_t>(at)].data();
    }

    void encode(Index begin, Index end) {
        const KernelNetwork& net = network->kernel;
        const Index halo = net.halo, wide = args.width + 2 * args.reach;
        std::vector<Index> rows, columns;
        for (Index y = begin - halo; y < end + halo; ++y) rows.push_back(placed(y, args.height, args.wrap_rows));
        for (Index x = -args.reach - halo; x < args.width + args.reach + halo; ++x)
            columns.push_back(placed(x, args.width, args.wrap_columns));
        const auto kernel = MIPBAKE_DISPATCH(network_encode);
        parallel_for(wide, kTile, [&](Index from, Index to) {
            float* out[kBand];
            for (Index y = begin; y < end; ++y) out[y - begin] = ring_row(y) + from;
            const EncodeTile tile = {args.stored,
                                     args.width,
                                     network->counts.read,
                                     rows.data(),
                                     columns.data() + from,
                                     static_cast<int>(end - begin),
                                     static_cast<int>(to - from),
                                     out,
                                     plane};
            with_scratch([&](float* memory) { kernel(net, tile, memory); });
        });
    }

    void decode_top(Index begin, Index end) {
        const KernelNetwork& net = network->kernel;
        const auto kernel = MIPBAKE_DISPATCH(network_top);
        const Index tiles = (args.width + kChunk - 1) / kChunk;
        std::vector<const float*> rows;  // around the first row and on
        for (Index y = begin - args.reach; y < end + args.reach; ++y) rows.push_back(ring_row(y));
        parallel_for(tiles * (end - begin), 1, [&](Index item, Index) {
            const Index y = begin + item / tiles, from = item % tiles * kChunk;
            const TopTile tile = {rows.data() + (y - begin),
                                  from,
                                  plane,
                                  args.sharp,
                                  args.plain,
                                  args.reach,
                                  static_cast<int>(std::min<Index>(kChunk, args.width - from)),
                                  bias.data(),
                                  args.top + (y * args.width + from) * net.channels};
            with_scratch([&](float* memory) { kernel(net, tile, memory); });
        });
    }

    // Adds rows of an image to all that are filtered from it, `source` as NetworkSink has it.
    void feed(int source, const std::vector<Row>& rows, Index row_plane) {
        for (std::size_t index = 0; index < sinks.size(); ++index)
            if (sinks[index].args.source == source) add(static_cast<int>(index), rows, row_plane);
    }

    void add(int index, const std::vector<Row>& rows, Index row_plane) {
        const KernelNetwork& net = network->kernel;
        Sink& sink = sinks[static_cast<std::size_t>(index)];
        const Index detail = sink.decoded ? net.detail : 0;
        std::vector<AddRow> adds;
        std::vector<int> finished;
        for (const Row& row : rows)
            for (const Part& part : sink.parts[static_cast<std::size_t>(row.index)]) {
                int& slot = sink.slot[static_cast<std::size_t>(part.row)];
                const bool first = slot < 0;
                if (first) {
                    if (sink.free.empty()) {
                        sink.sums.emplace_back((latents + detail) * sink.plane);
                        sink.free.push_back(static_cast<int>(sink.sums.size()) - 1);
                    }
                    slot = sink.free.back();
                    sink.free.pop_back();
                }
                adds.push_back({row.planes, row_plane, sink.sums[static_cast<std::size_t>(slot)].data(), sink.plane,
                                part.sharp, part.plain, first});
                if (--sink.left[static_cast<std::size_t>(part.row)] == 0) finished.push_back(part.row);
            }
        const auto kernel = MIPBAKE_DISPATCH(network_add);
        parallel_for(sink.width, kColumns, [&](Index begin, Index end) {
            for (const AddRow& each : adds) kernel(each, latents, detail, begin, end);
        });
        const Index wide = sink.feeds ? rounded_up(sink.args.columns.n, kSlack) + kSlack : 0;
        for (const int row : finished) {
            const Floats made(latents * wide);
            across(sink, row, sink.feeds ? made.data() : nullptr, wide);
            if (sink.feeds) feed(index, {{row, made.data()}}, wide);
        }
        for (const int row : finished) sink.free.push_back(sink.slot[static_cast<std::size_t>(row)]);
    }

    void across(const Sink& sink, int row, float* planes, Index planes_stride) {
        const KernelNetwork& net = network->kernel;
        const Index channels = latents + (sink.decoded ? net.detail : 0);
        const float* const sums = sink.sums[static_cast<std::size_t>(sink.slot[static_cast<std::size_t>(row)])].data();
        const auto transpose = MIPBAKE_DISPATCH(network_transpose);
        parallel_for(sink.width, kColumns, [&](Index begin, Index end) {
            transpose(sums, sink.plane, channels, begin, end, transposed.data(), texel);
        });
        const auto kernel = MIPBAKE_DISPATCH(network_across);
        const AxisWeights& columns = sink.args.columns;
        parallel_for(columns.n, kChunk, [&](Index begin, Index end) {
            const Index at = begin * columns.taps;
            float* const out =
                sink.decoded ? sink.args.out + (static_cast<Index>(row) * columns.n + begin) * net.channels : nullptr;
            const AcrossTile tile = {transposed.data(),
                                     texel,
                                     columns.index + at,
                                     columns.sharp + at,
                                     columns.plain + at,
                                     columns.taps,
                                     static_cast<int>(end - begin),
                                     sink.bias.data(),
                                     out,
                                     planes == nullptr ? nullptr : planes + begin,
                                     planes_stride};
            with_scratch([&](float* memory) { kernel(net, tile, memory); });
        });
    }

    void advance() {
        const Index begin = done, end = std::min<Index>(args.height, begin + kBand);
        while (encoded < end + args.reach) {
            const Index to = std::min<Index>(end + args.reach, encoded + kBand);
            encode(encoded, to);
            encoded = to;
        }
        decode_top(begin, end);
        std::vector<Row> rows;
        for (Index y = begin; y < end; ++y) rows.push_back({y, ring_row(y) + args.reach});
        feed(-1, rows, plane);
        done = end;
    }
};

NetworkBake::NetworkBake(std::shared_ptr<const Network> network, const NetworkBakeArgs& args)
    : state_(std::make_unique<State>(std::move(network), args)) {}

NetworkBake::~NetworkBake() = default;

std::int64_t NetworkBake::rows_done() const { return state_->done; }

void NetworkBake::advance() {
    if (state_->done < state_->args.height) state_->advance();
}

}  // namespace mipbake
