// SPDX-License-Identifier: Apache-2.0
// Can a classifier tell two kinds of range images apart by what a patch of them looks like?
#include <relidar/metrics.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include <fmt/format.h>

#include "boosted_trees.hpp"
#include "core/parallel.hpp"
#include "core/random.hpp"
#include "pixel_errors.hpp"
#include <relidar/error.hpp>

namespace relidar {
namespace {

using namespace metrics_detail;

constexpr std::size_t kPixels = PatchPairs::kPixels, kFeatures = PatchPairs::kFeatures;

/// What a classifier sees of a patch, beside its centre.
struct Sight {
    const char* name;
    std::size_t first, n;   ///< features
};
// What takes longest comes first, or one core would end with it alone; scores are told in the reverse order.
constexpr std::array<Sight, 4> kSights{{{"all", 0, 3 * kPixels}, {"mask", 2 * kPixels, kPixels}, {"intensity", kPixels, kPixels},
                                        {"range", 0, kPixels}}};

void append_patch(std::vector<float>& patches, const RangeImage& image, const Mask& returns, std::size_t centre) {
    const int row = int(centre) / image.columns, column = int(centre) % image.columns;
    const float centre_log = std::log1p(image.range_m[centre]);
    const std::size_t start = patches.size();
    patches.resize(start + kFeatures, 0.0f);
    float* const values = patches.data() + start;
    std::size_t k = 0;
    for (int dy = -PatchPairs::kRows / 2; dy <= PatchPairs::kRows / 2; ++dy)
        for (int dx = -PatchPairs::kColumns / 2; dx <= PatchPairs::kColumns / 2; ++dx, ++k) {
            const int y = std::clamp(row + dy, 0, image.rows - 1), x = ((column + dx) % image.columns + image.columns) % image.columns;
            const std::size_t pixel = std::size_t(y) * std::size_t(image.columns) + std::size_t(x);
            if (!returns[pixel]) continue;
            values[k] = std::log1p(image.range_m[pixel]) - centre_log;
            values[kPixels + k] = std::clamp(image.intensity[pixel], 0.0f, 1.0f);
            values[2 * kPixels + k] = 1.0f;
        }
    values[3 * kPixels] = centre_log;
    values[3 * kPixels + 1] = float(row) / float(image.rows);
}

/// A feature's column of a sight: those it sees, then the centre's.
void append_rows(LabelledRows& rows, const std::vector<float>& patches, const Sight& sight, std::uint8_t label) {
    for (std::size_t start = 0; start < patches.size(); start += kFeatures) {
        const auto patch = patches.begin() + std::ptrdiff_t(start);
        rows.features.insert(rows.features.end(), patch + std::ptrdiff_t(sight.first), patch + std::ptrdiff_t(sight.first + sight.n));
        rows.features.insert(rows.features.end(), patch + std::ptrdiff_t(3 * kPixels), patch + std::ptrdiff_t(kFeatures));
        rows.label.push_back(label);
    }
    rows.n_features = sight.n + 2;
}

void append_frame(LabelledRows& rows, const PatchPairs& frame, const Sight& sight) {
    append_rows(rows, frame.first(), sight, 0);
    append_rows(rows, frame.second(), sight, 1);
}

/// Of one frame, by trees that have not seen it.
struct FrameScore {
    double auc = 0.0, accuracy = 0.0;
};

FrameScore score_frame(const BoostedTrees& trees, const PatchPairs& frame, const Sight& sight) {
    LabelledRows rows;
    append_frame(rows, frame, sight);
    std::vector<double> score(rows.size());
    std::size_t n_right = 0;
    for (std::size_t i = 0; i < score.size(); ++i) {
        score[i] = trees.score(rows.row(i));
        n_right += (score[i] > 0.0) == (rows.label[i] == 1);
    }
    return {area_under_roc(score, rows.label), double(n_right) / double(rows.size())};
}

/// @param of  member of a score [frames, at least 2]
Estimate estimate(const std::vector<FrameScore>& frames, double FrameScore::* of) {
    const double n = double(frames.size());
    double mean = 0.0, squares = 0.0;
    for (const FrameScore& frame : frames) mean += frame.*of / n;
    for (const FrameScore& frame : frames) squares += (frame.*of - mean) * (frame.*of - mean);
    return {mean, std::sqrt(squares / (n * (n - 1.0)))};
}

}  // namespace

void PatchPairs::add(const RangeImage& first, const RangeImage& second, std::size_t n, std::uint64_t seed) {
    check_pair(second, first);
    const Mask in_first = returned(first, kRealDropThreshold), in_second = returned(second, kRealDropThreshold);
    std::vector<std::size_t> centres;
    for (std::size_t i = 0; i < in_first.size(); ++i)
        if (in_first[i] && in_second[i]) centres.push_back(i);
    n = std::min(n, centres.size());
    Random random(seed);
    for (std::size_t i = 0; i < n; ++i) std::swap(centres[i], centres[i + random.next() % (centres.size() - i)]);
    for (std::size_t i = 0; i < n; ++i) {
        append_patch(first_, first, in_first, centres[i]);
        append_patch(second_, second, in_second, centres[i]);
    }
}

std::vector<TwoSampleScore> two_sample_test(const std::vector<PatchPairs>& frames) {
    if (frames.size() < 2) throw DataError(fmt::format("two-sample test: found {} frames, expected at least 2", frames.size()));
    if (std::any_of(frames.begin(), frames.end(), [](const PatchPairs& frame) { return frame.size() == 0; }))
        throw DataError("two-sample test: found a frame without a patch, expected some in each");
    std::array<std::vector<FrameScore>, kSights.size()> scores;
    scores.fill(std::vector<FrameScore>(frames.size()));
    run_parallel(2 * int(kSights.size()), [&](int task) {
        const std::size_t s = std::size_t(task) / 2, learns_from = std::size_t(task) % 2;
        LabelledRows rows;
        for (std::size_t f = learns_from; f < frames.size(); f += 2) append_frame(rows, frames[f], kSights[s]);
        const BoostedTrees trees(rows);
        for (std::size_t f = 1 - learns_from; f < frames.size(); f += 2) scores[s][f] = score_frame(trees, frames[f], kSights[s]);
    });
    std::vector<TwoSampleScore> result;
    for (std::size_t s = kSights.size(); s-- > 0;)
        result.push_back({kSights[s].name, estimate(scores[s], &FrameScore::auc), estimate(scores[s], &FrameScore::accuracy)});
    return result;
}

}  // namespace relidar
