#include "cpu/network.h"

#include <algorithm>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "core/mutex.h"
#include "core/parallel.h"
#include "cpu/network_sinks.h"
#include "cpu/network_weights.h"

// A bake goes down the image in bands of rows. Of each band the rows of latents that its filters reach are encoded into
// a ring of rows; level 0 is filtered and decoded; and the band is added to the rows of coarser images that it is a
// part of. A row of these that has got all its parts is filtered across, and decoded, or handed on to images that are
// coarser still. Every sum runs in the order of the rows.
//
// Threads meet twice a band, because handing a loop over to a thread takes as long as a task does: when the band is
// encoded, and when all that reads it is done. A task of the second kind takes some texels of an image, adds up all
// that they are filtered from, and decodes those of the rows that are complete, so that sums stay in the cache of one
// core.

namespace mipbake {

using Index = std::int64_t;

namespace {

// Rows of a sink that a task filters across together, from sums in its scratch.
constexpr int kComplete = 8;

using Task = std::function<void(float* scratch)>;

// What a step adds to the rows of a sink, for the tasks that do so.
struct Addition {
    std::vector<Sum> sums;
    Index row_plane;
};

}  // namespace

struct NetworkBake::State {
    // A row that is filtered for other sinks, and where it lies in memory.
    struct Ready {
        int row, latents;
    };

    // A sink; its rows that the step adds to others, and those that it filters for the next step.
    struct Stage {
        Sink sink;
        std::vector<Ready> added, ready;
    };

    std::shared_ptr<const Network> network;
    NetworkBakeArgs args;
    NetworkPart part;
    const Sink* kept = nullptr;
    std::vector<Stage> stages;
    std::vector<float> bias;
    Index latents, plane, ring_rows, encoded, done = 0;
    std::vector<Index> columns;  // of level 0 that the encoder reads, from left to right
    std::vector<Floats> ring;
    Index texel;  // floats from texel to texel where channels lie side by side
    Mutex lending;
    std::vector<std::unique_ptr<Floats>> scratch;
    Index texels_floats, filter_floats, task_floats;  // of scratch: for texels of a span, with a decoder, for any task

    State(std::shared_ptr<const Network> given, const NetworkBakeArgs& a, const NetworkPart& p)
        : network(std::move(given)), args(a), part(p), bias(network->padded(a.bias)) {
        const KernelNetwork& net = network->kernel;
        latents = net.moments + net.learned;
        plane = part.latents != nullptr ? latents_plane(args.width)
                                        : rounded_up(args.width + 2 * args.reach, kSlack) + kTile + 2 * kSlack;
        ring_rows = part.latents != nullptr ? 0 : kBand + 2 * args.reach;
        encoded = part.latents != nullptr ? args.height + args.reach : -args.reach;
        for (Index i = 0; i < ring_rows; ++i) ring.emplace_back(latents * plane + 2 * kSlack);
        for (Index x = -args.reach - net.halo; x < args.width + args.reach + net.halo; ++x)
            columns.push_back(placed(x, args.width, args.wrap_columns));
        texel = rounded_up(latents + net.detail, kSlack);
        Index widest = 0;
        for (int i = 0; i < args.sink_count; ++i) {
            stages.push_back({sink(args.sinks[i]), {}, {}});
            for (const Span& span : stages.back().sink.spans) widest = std::max(widest, span.columns);
        }
        for (int i = 0; i < args.sink_count; ++i)
            if (args.sinks[i].source >= 0) sink_of(args.sinks[i].source).feeds = true;
        if (part.kept >= 0) kept = &sink_of(part.kept);
        texels_floats = widest * texel;
        filter_floats = texels_floats + MIPBAKE_DISPATCH(network_decode_scratch)(net, args.reach);
        task_floats = std::max(MIPBAKE_DISPATCH(network_encode_scratch)(net),
                               filter_floats + kComplete * (latents + net.detail) * widest);
    }

    Sink& sink_of(int index) { return stages[static_cast<std::size_t>(index)].sink; }

    Sink sink(const NetworkSink& given) {
        const bool top = given.source < 0;
        const Index height = top ? args.height : sink_of(given.source).args.rows.n;
        const Index width = top ? args.width : sink_of(given.source).args.columns.n;
        return Sink(given, height, width, latents, network->kernel.detail,
                    given.out != nullptr ? network->padded(given.bias) : std::vector<float>());
    }

    // Calls f(scratch) with memory that no other thread uses meanwhile.
    template <class F>
    void with_scratch(F&& f) {
        std::unique_ptr<Floats> lent;
        {
            const std::lock_guard<Mutex> lock(lending);
            if (!scratch.empty()) {
                lent = std::move(scratch.back());
                scratch.pop_back();
            }
        }
        if (lent == nullptr) lent = std::make_unique<Floats>(task_floats);
        f(lent->data());
        const std::lock_guard<Mutex> lock(lending);
        scratch.push_back(std::move(lent));
    }

    Index placed(Index at, Index size, bool wrap) const {
        if (!wrap) return std::clamp<Index>(at, 0, size - 1);
        const Index rest = at % size;
        return rest < 0 ? rest + size : rest;
    }

    // A row of latents of level 0, from its first texel on.
    const float* source_row(Index row) const {
        return part.latents != nullptr ? part.latents + row * latents * plane : ring_row(row) + args.reach;
    }

    float* ring_row(Index row) const {
        const Index at = (row + args.reach) % ring_rows;
        return ring[static_cast<std::size_t>(at)].data() + rounded_up(args.reach, kSlack) - args.reach;
    }

    // Rows of latents up to `to`.
    void encode(Index to, std::vector<Task>& tasks) {
        const KernelNetwork& net = network->kernel;
        const Index wide = args.width + 2 * args.reach;
        while (encoded < to) {
            const Index begin = encoded, end = std::min<Index>(to, begin + kBand);
            const auto rows = std::make_shared<std::vector<Index>>();
            for (Index y = begin - net.halo; y < end + net.halo; ++y)
                rows->push_back(placed(y, args.height, args.wrap_rows));
            for (Index from = 0; from < wide; from += kTile)
                tasks.push_back([this, rows, begin, end, from, wide](float* memory) {
                    float* out[kBand];
                    for (Index y = begin; y < end; ++y) out[y - begin] = ring_row(y) + from;
                    const EncodeTile tile = {args.stored,
                                             args.width,
                                             network->counts.read,
                                             rows->data(),
                                             columns.data() + from,
                                             static_cast<int>(end - begin),
                                             static_cast<int>(std::min<Index>(kTile, wide - from)),
                                             out,
                                             plane};
                    MIPBAKE_DISPATCH(network_encode)(network->kernel, tile, memory);
                });
            encoded = end;
        }
    }

    // Level 0.
    void decode(Index begin, Index end, std::vector<Task>& tasks) const {
        begin = std::max(begin, part.begin);
        end = std::min(end, part.end);
        if (begin >= end) return;
        const auto rows = std::make_shared<std::vector<const float*>>();  // around the first row and on
        for (Index y = begin - args.reach; y < end + args.reach; ++y) rows->push_back(ring_row(y));
        for (Index y = begin; y < end; ++y)
            for (Index from = 0; from < args.width; from += kChunk)
                tasks.push_back([this, rows, begin, y, from](float* memory) {
                    const TopTile tile = {rows->data() + (y - begin),
                                          from,
                                          plane,
                                          args.sharp,
                                          args.plain,
                                          args.reach,
                                          static_cast<int>(std::min<Index>(kChunk, args.width - from)),
                                          bias.data(),
                                          args.top + ((y - part.begin) * args.width + from) * network->kernel.channels};
                    MIPBAKE_DISPATCH(network_top)(network->kernel, tile, memory);
                });
    }

    // Adds rows to a sink and filters those across that are complete then: f(take) calls take(row, planes) for each.
    template <class F>
    void add(Stage& stage, Index row_plane, F&& f, std::vector<Task>& tasks) {
        Sink& sink = stage.sink;
        const auto made = std::make_shared<Addition>();
        made->row_plane = row_plane;
        f([&](Index row, const float* planes) { sink.take(row, planes, made->sums); });
        sink.place(made->sums);
        for (const Sum& sum : made->sums)
            if (sum.latents >= 0) stage.ready.push_back({sum.row, sum.latents});
        if (made->sums.empty()) return;
        for (const Span& span : sink.spans)
            tasks.push_back([this, &sink, made, &span](float* memory) { add_span(sink, *made, span, memory); });
    }

    // Sums that are complete are not kept: they lie in `memory`.
    void add_span(const Sink& sink, const Addition& made, const Span& span, float* memory) const {
        const auto kernel = MIPBAKE_DISPATCH(network_add);
        std::vector<AddRow> rows;
        for (std::size_t first = 0, last = 0; first < made.sums.size(); first = last) {
            rows.clear();
            float* complete = memory + filter_floats;
            for (int left = kComplete; last < made.sums.size() && left > 0; ++last) {
                const Sum& sum = made.sums[last];
                float* const kept = sum.slot < 0 ? nullptr : sink.sums.at(sum.slot) + span.offset;
                rows.push_back({sum.taps.data(), static_cast<int>(sum.taps.size()), sum.begun ? kept : nullptr,
                                sum.last ? complete : kept});
                if (!sum.last) continue;
                complete += (latents + sink.detail) * span.columns;
                --left;
            }
            for (const Span::Range& range : span.ranges)
                for (Index from = range.begin; from < range.end; from += kColumns)
                    kernel({rows.data(), static_cast<int>(rows.size()), latents, sink.detail, made.row_plane,
                            span.columns, from, range.place + from - range.begin,
                            std::min<Index>(kColumns, range.end - from)});
            for (std::size_t i = first; i < last; ++i)
                if (made.sums[i].last) across(sink, made.sums[i], span, rows[i - first].into, memory);
        }
    }

    // Filters texels of a row across from its sums.
    void across(const Sink& sink, const Sum& row, const Span& span, const float* sums, float* memory) const {
        const KernelNetwork& net = network->kernel;
        MIPBAKE_DISPATCH(network_transpose)(sums, span.columns, latents + sink.detail, span.columns, memory, texel);
        const AxisWeights& axis = sink.args.columns;
        const Index at = span.begin * axis.taps, place = static_cast<Index>(row.row) * axis.n + span.begin;
        float* const latents_at = &sink == kept     ? part.out + row.row * latents * sink.latents_plane
                                  : row.latents < 0 ? nullptr
                                                    : sink.latents.at(row.latents);
        const AcrossTile tile = {memory,
                                 texel,
                                 sink.at.data() + at,
                                 axis.sharp + at,
                                 axis.plain + at,
                                 axis.taps,
                                 static_cast<int>(span.end - span.begin),
                                 sink.bias.data(),
                                 sink.decoded() ? sink.args.out + place * net.channels : nullptr,
                                 latents_at == nullptr ? nullptr : latents_at + span.begin,
                                 sink.latents_plane};
        MIPBAKE_DISPATCH(network_across)(net, tile, memory + texels_floats);
    }

    // Rows [begin, end) of level 0, and what the step before has got ready for coarser ones.
    void step(Index begin, Index end) {
        std::vector<Task> tasks;
        encode(end + args.reach, tasks);
        run(tasks);
        add_all(begin, end, tasks);
        decode(begin, end, tasks);
        run(tasks);
        done = end;
    }

    void add_all(Index begin, Index end, std::vector<Task>& tasks) {
        for (Stage& stage : stages) {
            for (const Ready& row : stage.added) stage.sink.latents.give_back(row.latents);
            stage.added = std::exchange(stage.ready, {});
        }
        for (Stage& stage : stages) {
            const int source = stage.sink.args.source;
            if (source < 0) {
                const auto band = [&](auto&& take) {
                    for (Index y = begin; y < end; ++y) take(y, source_row(y));
                };
                add(stage, plane, band, tasks);
                continue;
            }
            const Stage& from = stages[static_cast<std::size_t>(source)];
            const auto rows = [&](auto&& take) {
                for (const Ready& row : from.added) take(row.row, from.sink.latents.at(row.latents));
            };
            add(stage, from.sink.latents_plane, rows, tasks);
        }
    }

    // Runs tasks, and leaves none.
    void run(std::vector<Task>& tasks) {
        parallel_for(static_cast<Index>(tasks.size()), 1, [&](Index task, Index) {
            with_scratch([&](float* memory) { tasks[static_cast<std::size_t>(task)](memory); });
        });
        tasks.clear();
    }

    void advance() {
        step(done, std::min<Index>(args.height, done + kBand));
        const auto busy = [](const Stage& stage) { return !stage.ready.empty(); };
        while (done == args.height && std::any_of(stages.begin(), stages.end(), busy)) step(done, done);
    }
};

NetworkBake::NetworkBake(std::shared_ptr<const Network> network, const NetworkBakeArgs& args)
    : NetworkBake(std::move(network), args, {0, args.height, nullptr, -1, nullptr}) {}

NetworkBake::NetworkBake(std::shared_ptr<const Network> network, const NetworkBakeArgs& args, const NetworkPart& part)
    : state_(std::make_unique<State>(std::move(network), args, part)) {}

NetworkBake::~NetworkBake() = default;

std::int64_t NetworkBake::rows_done() const { return state_->done; }

std::int64_t NetworkBake::row_floats(const Network& network, std::int64_t n) {
    return (network.kernel.moments + network.kernel.learned) * latents_plane(n);
}

void NetworkBake::advance() {
    if (state_->done < state_->args.height) state_->advance();
}

}  // namespace mipbake
