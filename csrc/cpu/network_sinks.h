// Images that a bake filters from finer ones: which rows wait for which parts, and where they lie in memory.
#pragma once

#include <cstdint>
#include <vector>

#include "cpu/network.h"
#include "cpu/network_weights.h"

namespace mipbake {

// Floats from channel to channel of a row of n latents.
constexpr std::int64_t latents_plane(std::int64_t n) { return rounded_up(n, kSlack) + kSlack; }

// Memory for rows of one size. Rows that are given back are lent again.
class RowMemory {
  public:
    explicit RowMemory(std::int64_t floats) : floats_(floats) {}
    int take();
    void give_back(int row) { free_.push_back(row); }
    float* at(int row) const { return rows_[static_cast<std::size_t>(row)].data(); }

  private:
    std::int64_t floats_;
    std::vector<Floats> rows_;
    std::vector<int> free_;
};

// Texels [begin, end) of a row, and the columns of the finer image that they are filtered from. Sums of a span lie
// together: one plane of `columns` for each channel, at `offset` in the memory of a row.
struct Span {
    struct Range {
        std::int64_t begin, end, place;  // place: where it begins in the planes
    };
    std::int64_t begin, end;
    std::vector<Range> ranges;
    std::int64_t columns, offset;
};

// What some rows of the finer image add to a row.
struct Sum {
    int row, slot, latents;  // places in memory: of its sums, and of what is filtered from them; -1 for none
    bool begun, last;        // the sums hold something; they are complete after that
    std::vector<AddTap> taps;
};

class Sink {
  public:
    // The finer image has height x width texels of `latents` channels. `detail` further sums are kept where the sink
    // is decoded.
    Sink(const NetworkSink& args, std::int64_t height, std::int64_t width, std::int64_t latents, std::int64_t detail,
         std::vector<float> bias);

    // Notes that a row of the finer image, which lies at `planes`, is added, and tells to what in `sums`.
    void take(std::int64_t row, const float* planes, std::vector<Sum>& sums);

    // Lends memory to the sums, and takes back what those have that were complete before.
    void place(std::vector<Sum>& sums);

    bool decoded() const { return args.out != nullptr; }

    NetworkSink args;
    std::int64_t detail;
    std::int64_t latents_plane;    // floats from channel to channel of rows that are filtered
    bool feeds = false;            // others
    std::vector<float> bias;       // of the decoder
    std::vector<std::int32_t> at;  // as args.columns.index, but places in the planes of the span
    std::vector<Span> spans;       // of a row
    RowMemory sums, latents;

  private:
    // Which rows a row of the finer image is a part of.
    struct Part {
        int row;
        float sharp, plain;
    };

    void note_parts();

    std::vector<std::vector<Part>> parts_;  // by row of the finer image
    std::vector<int> left_, slot_;          // parts that a row waits for, and the memory of its sums
    std::vector<int> complete_;             // memory of sums that the last step has completed
};

}  // namespace mipbake
