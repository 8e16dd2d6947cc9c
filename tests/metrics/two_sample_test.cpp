// SPDX-License-Identifier: Apache-2.0
// Patches against loops that follow their definition, and the test on images of which it is known what can be told.
#include <relidar/metrics.hpp>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

#include <gtest/gtest.h>

#include "core/random.hpp"
#include <relidar/error.hpp>

namespace relidar {
namespace {

/// Ranges, intensities and drops without any order.
RangeImage noise_image(int rows, int columns, std::uint64_t seed) {
    Random random(seed);
    RangeImage image{rows, columns, {}, {}, {}, {}, {}};
    for (int i = 0; i < rows * columns; ++i) {
        const bool drops = random.uniform() < 0.3;
        image.range_m.push_back(drops ? 0.0f : float(random.uniform(2.0, 60.0)));
        image.intensity.push_back(drops ? 0.0f : float(random.uniform()));
        image.drop_prob.push_back(drops ? 1.0f : 0.0f);
        image.origin.emplace_back(0.0f);
        image.direction.emplace_back(1.0f, 0.0f, 0.0f);
    }
    return image;
}

bool returns(const RangeImage& image, int row, int column) {
    const std::size_t i = std::size_t(row * image.columns + column);
    return image.drop_prob[i] < 0.5f && image.range_m[i] > 0.0f;
}

/// A patch by its definition.
std::vector<float> patch_at(const RangeImage& image, int row, int column) {
    std::vector<float> range, intensity, mask;
    const auto log_range = [&](int y, int x) { return std::log(1.0f + image.range_m[std::size_t(y * image.columns + x)]); };
    for (int y = row - 2; y <= row + 2; ++y)
        for (int x = column - 4; x <= column + 4; ++x) {
            const int at_row = y < 0 ? 0 : y >= image.rows ? image.rows - 1 : y;
            const int at_column = x < 0 ? x + image.columns : x >= image.columns ? x - image.columns : x;
            const bool there = returns(image, at_row, at_column);
            range.push_back(there ? log_range(at_row, at_column) - log_range(row, column) : 0.0f);
            intensity.push_back(there ? image.intensity[std::size_t(at_row * image.columns + at_column)] : 0.0f);
            mask.push_back(there ? 1.0f : 0.0f);
        }
    range.insert(range.end(), intensity.begin(), intensity.end());
    range.insert(range.end(), mask.begin(), mask.end());
    range.push_back(log_range(row, column));
    range.push_back(float(row) / float(image.rows));
    return range;
}

/// Whether a patch is that of a pixel.
bool equal(const float* patch, const std::vector<float>& expected) {
    for (std::size_t k = 0; k < expected.size(); ++k)
        if (std::abs(patch[k] - expected[k]) > 1e-5f) return false;
    return true;
}

TEST(PatchPairs, AreOfAllPixelsThatReturnInBoth) {
    const RangeImage first = noise_image(6, 11, 1), second = noise_image(6, 11, 2);   // every pixel is near an edge
    PatchPairs patches;
    patches.add(first, second, 1000, 3);
    std::size_t n = 0;
    for (int row = 0; row < 6; ++row)
        for (int column = 0; column < 11; ++column) {
            if (!returns(first, row, column) || !returns(second, row, column)) continue;
            ++n;
            const std::vector<float> a = patch_at(first, row, column), b = patch_at(second, row, column);
            int found = 0;
            for (std::size_t i = 0; i < patches.size(); ++i)
                found += equal(patches.first().data() + i * PatchPairs::kFeatures, a) &&
                         equal(patches.second().data() + i * PatchPairs::kFeatures, b);
            EXPECT_EQ(found, 1) << "row " << row << " column " << column;
        }
    EXPECT_EQ(patches.size(), n);
    EXPECT_EQ(patches.second().size(), n * PatchPairs::kFeatures);
}

TEST(PatchPairs, AreDrawnBySeed) {
    const RangeImage first = noise_image(16, 40, 1), second = noise_image(16, 40, 2);
    PatchPairs a, b, other;
    a.add(first, second, 50, 3);
    b.add(first, second, 50, 3);
    other.add(first, second, 50, 4);
    EXPECT_EQ(a.size(), 50u);
    EXPECT_EQ(a.first(), b.first());
    EXPECT_NE(a.first(), other.first());
    a.add(second, first, 50, 3);   // another LiDAR of the same moment
    EXPECT_EQ(a.size(), 100u);
}

TEST(PatchPairs, RefuseImagesThatDiffer) {
    PatchPairs patches;
    EXPECT_THROW(patches.add(noise_image(6, 12, 1), noise_image(6, 11, 1), 9, 0), DataError);
    RangeImage bad = noise_image(6, 12, 1);
    bad.intensity[5] = std::numeric_limits<float>::quiet_NaN();
    EXPECT_THROW(patches.add(noise_image(6, 12, 1), bad, 9, 0), DataError);
    EXPECT_THROW(patches.add(bad, noise_image(6, 12, 1), 9, 0), DataError);
    EXPECT_EQ(patches.size(), 0u);
}

constexpr std::size_t kFrames = 4, kOfFrame = 500;

/// Scores of noise beside noise that is changed, by what is seen: range, intensity, mask, all.
std::vector<TwoSampleScore> told(const std::function<void(RangeImage&, std::size_t pixel)>& change) {
    std::vector<PatchPairs> frames(kFrames);
    for (std::size_t f = 0; f < kFrames; ++f) {
        RangeImage changed = noise_image(64, 512, 2 * f + 101);   // patches hardly overlap
        for (std::size_t i = 0; i < changed.range_m.size(); ++i)
            if (changed.drop_prob[i] == 0.0f) change(changed, i);
        frames[f].add(noise_image(64, 512, 2 * f + 100), changed, kOfFrame, f);
    }
    return two_sample_test(frames);
}

/// That the sight at a place tells nothing, the area being that of equal samples (Mann and Whitney), the accuracy that of guesses.
void expect_no_sight(const TwoSampleScore& score) {
    constexpr double kN = double(kFrames * kOfFrame);
    const double area_error = std::sqrt((2.0 * double(kOfFrame) + 1.0) / (12.0 * double(kOfFrame) * double(kOfFrame) * double(kFrames)));
    EXPECT_NEAR(score.auc.value, 0.5, 3.0 * area_error) << score.sees;
    EXPECT_NEAR(score.accuracy.value, 0.5, 3.0 * 0.5 / std::sqrt(2.0 * kN)) << score.sees;
    EXPECT_LT(score.auc.error, 3.0 * area_error) << score.sees;    // of four frames: chi squared of three degrees of freedom lies
    EXPECT_GT(score.auc.error, area_error / 10.0) << score.sees;   // outside 0.03..27 once in a thousand times
}

void expect_sight(const TwoSampleScore& score) {
    EXPECT_GT(score.auc.value, 0.95) << score.sees;
    EXPECT_GT(score.accuracy.value, 0.9) << score.sees;
}

TEST(TwoSampleTest, TellsNothingOfEqualImages) {
    const std::vector<TwoSampleScore> scores = told([](RangeImage&, std::size_t) {});
    ASSERT_EQ(scores.size(), 4u);
    EXPECT_EQ(scores[0].sees, "range");
    EXPECT_EQ(scores[1].sees, "intensity");
    EXPECT_EQ(scores[2].sees, "mask");
    EXPECT_EQ(scores[3].sees, "all");
    for (const TwoSampleScore& score : scores) expect_no_sight(score);
}

TEST(TwoSampleTest, TellsWhatWasChangedAndNothingElse) {
    const std::vector<TwoSampleScore> darker = told([](RangeImage& image, std::size_t i) { image.intensity[i] *= 0.5f; });
    expect_no_sight(darker[0]);
    expect_sight(darker[1]);
    expect_no_sight(darker[2]);
    expect_sight(darker[3]);
    const std::vector<TwoSampleScore> emptier = told([](RangeImage& image, std::size_t i) {
        if (hash64(i) % 3 == 0) image.range_m[i] = image.intensity[i] = 0.0f, image.drop_prob[i] = 1.0f;
    });
    expect_sight(emptier[2]);
    expect_sight(emptier[3]);
    // The range of every pixel of a block is one of them: the centre's is drawn as before, and steps to its neighbours are gone.
    const std::vector<TwoSampleScore> blocky = told([](RangeImage& image, std::size_t i) {
        std::size_t of_block = i / (8 * 512) * (8 * 512) + i % 512 / 16 * 16;
        while (!(image.range_m[of_block] > 0.0f)) ++of_block;
        image.range_m[i] = image.range_m[of_block];
    });
    expect_sight(blocky[0]);
    expect_no_sight(blocky[2]);
}

TEST(TwoSampleTest, NeedsTwoFramesWithPatches) {
    std::vector<PatchPairs> frames(1);
    frames[0].add(noise_image(16, 40, 1), noise_image(16, 40, 2), 50, 0);
    EXPECT_THROW(two_sample_test(frames), DataError);
    frames.emplace_back();
    EXPECT_THROW(two_sample_test(frames), DataError);
}

}  // namespace
}  // namespace relidar
