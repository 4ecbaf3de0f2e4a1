#include "cpu/network_sinks.h"

#include <algorithm>
#include <utility>

namespace mipbake {

using Index = std::int64_t;

namespace {

Index floats_of(const std::vector<Span>& spans, Index channels) {
    Index out = 0;
    for (const Span& span : spans) out += channels * span.columns;
    return out;
}

// The spans of a row of an image that is filtered from one of `width` columns; `at` as Sink has it. Ranges are whole
// packets, so that these lie on their boundaries in memory.
std::vector<Span> spans_of(const AxisWeights& columns, Index width, Index channels, std::vector<std::int32_t>& at) {
    std::vector<Span> out;
    for (Index begin = 0; begin < columns.n; begin += kChunk) {
        Span span = {begin, std::min<Index>(columns.n, begin + kChunk), {}, 0, floats_of(out, channels)};
        const std::int32_t* const first = columns.index + begin * columns.taps;
        const std::int32_t* const last = columns.index + span.end * columns.taps;
        std::vector<std::int32_t> seen(first, last);  // packets
        for (std::int32_t& each : seen) each /= kSlack;
        std::sort(seen.begin(), seen.end());
        seen.erase(std::unique(seen.begin(), seen.end()), seen.end());
        for (const Index packet : seen) {
            const Index from = packet * kSlack;
            if (span.ranges.empty() || span.ranges.back().end != from)
                span.ranges.push_back({from, from, span.columns});
            span.ranges.back().end = std::min<Index>(width, from + kSlack);
            span.columns += kSlack;
        }
        for (const std::int32_t* each = first; each != last; ++each) {
            const auto packet = std::lower_bound(seen.begin(), seen.end(), *each / kSlack);
            at.push_back(static_cast<std::int32_t>((packet - seen.begin()) * kSlack + *each % kSlack));
        }
        out.push_back(std::move(span));
    }
    return out;
}

}  // namespace

int RowMemory::take() {
    if (free_.empty()) {
        rows_.emplace_back(floats_);
        return static_cast<int>(rows_.size()) - 1;
    }
    const int out = free_.back();
    free_.pop_back();
    return out;
}

Sink::Sink(const NetworkSink& given, Index height, Index width, Index latent, Index further,
           std::vector<float> own_bias)
    : args(given),
      detail(given.out != nullptr ? further : 0),
      latents_plane(mipbake::latents_plane(given.columns.n)),
      bias(std::move(own_bias)),
      spans(spans_of(given.columns, width, latent + detail, at)),
      sums(floats_of(spans, latent + detail)),
      latents(latent * latents_plane),
      parts_(static_cast<std::size_t>(height)),
      left_(static_cast<std::size_t>(given.rows.n)),
      slot_(static_cast<std::size_t>(given.rows.n), -1) {
    note_parts();
}

void Sink::note_parts() {
    const AxisWeights& rows = args.rows;
    for (int row = 0; row < rows.n; ++row)
        for (int tap = 0; tap < rows.taps; ++tap) {
            const Index each = static_cast<Index>(row) * rows.taps + tap;
            auto& parts = parts_[static_cast<std::size_t>(rows.index[each])];
            if (!parts.empty() && parts.back().row == row) {  // where many taps are one row
                parts.back().sharp += rows.sharp[each];
                parts.back().plain += rows.plain[each];
                continue;
            }
            parts.push_back({row, rows.sharp[each], rows.plain[each]});
            ++left_[static_cast<std::size_t>(row)];
        }
}

void Sink::take(Index row, const float* planes, std::vector<Sum>& out) {
    for (const Part& part : parts_[static_cast<std::size_t>(row)]) {
        auto sum = std::find_if(out.begin(), out.end(), [&](const Sum& each) { return each.row == part.row; });
        if (sum == out.end()) sum = out.insert(out.end(), {part.row, -1, -1, false, false, {}});
        sum->taps.push_back({planes, part.sharp, part.plain});
        sum->last = --left_[static_cast<std::size_t>(part.row)] == 0;
    }
}

void Sink::place(std::vector<Sum>& out) {
    for (const int slot : std::exchange(complete_, {})) sums.give_back(slot);
    for (Sum& sum : out) {
        int& slot = slot_[static_cast<std::size_t>(sum.row)];
        sum.begun = slot >= 0;
        if (!sum.last && !sum.begun) slot = sums.take();
        if (sum.last && sum.begun) complete_.push_back(slot);
        if (sum.last && feeds) sum.latents = latents.take();
        sum.slot = slot;
    }
}

}  // namespace mipbake
