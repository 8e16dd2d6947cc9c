// SPDX-License-Identifier: Apache-2.0
// Estimates the stride of a walking actor from the points in its box. Makes surfels that
// move periodically with the stride.
#include "scene/gait.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>
#include <numeric>

#include <fmt/format.h>

#include "base/parallel.hpp"
#include "base/progress_blocks.hpp"
#include "scene/sample_index.hpp"

namespace relidar {
namespace {

// Time over which positions are averaged, because the boxes of labels jitter.
constexpr double kAverage_s = 1.0;
constexpr double kStands_mps = 0.2;

double turn(double turns) { return turns - std::floor(turns); }
/// Returns the shortest signed difference second - first of two phases, -0.5 .. 0.5
/// strides.
double apart(double first, double second) { return second - first - std::round(second - first); }

}  // namespace

WalkedDistance::WalkedDistance(const PoseTrack& track) : time_s_(track.time_s) {
    const auto average = [&](double t_s) {
        const double half = std::min({0.5 * kAverage_s, t_s - time_s_.front(), time_s_.back() - t_s});
        constexpr int kSteps = 5;  // number of steps in each direction
        glm::dvec3 sum(0.0);
        for (int k = -kSteps; k <= kSteps; ++k) sum += track.at(t_s + half * k / kSteps).translation;
        return sum / double(2 * kSteps + 1);
    };
    glm::dvec3 before(0.0);
    double sum = 0.0;
    for (std::size_t i = 0; i < time_s_.size(); ++i) {
        const glm::dvec3 at = average(time_s_[i]);
        const double step = i == 0 ? 0.0 : glm::distance(before, at);
        if (i > 0 && step > kStands_mps * (time_s_[i] - time_s_[i - 1])) sum += step;
        walked_m_.push_back(sum);
        before = at;
    }
}

double WalkedDistance::at(double t_s) const {
    if (time_s_.size() < 2) return 0.0;
    const auto after = std::upper_bound(time_s_.begin() + 1, time_s_.end() - 1, t_s);
    const std::size_t i = std::size_t(after - time_s_.begin());
    const double s = (t_s - time_s_[i - 1]) / (time_s_[i] - time_s_[i - 1]);
    return walked_m_[i - 1] + s * (walked_m_[i] - walked_m_[i - 1]);
}

std::optional<StrideRange> get_stride_range(ObjectKind kind) {
    if (kind == ObjectKind::person) return StrideRange{0.7, 2.4};
    // A bicycle travels this many metres per turn of the pedals.
    if (kind == ObjectKind::cyclist) return StrideRange{2.0, 9.0};
    return std::nullopt;
}

namespace {

constexpr double kTurns = 2.0;          // minimum number of strides that must be observed
constexpr double kNearSurface_m = 0.3;  // upper limit for the distance to the nearest point

/// For some samples of an actor: the distance from the sample to the nearest sample of
/// each frame.
struct FrameGaps {
    /// [frames] distance that the actor had walked when each frame was recorded
    std::vector<double> walked_m;
    std::vector<std::size_t> frame;              ///< [samples] frame of each sample
    std::vector<std::vector<float>> distance_m;  ///< [samples][frames]
    /// [samples] true for the half of the samples whose distances vary most; these
    /// samples are on the limbs
    std::vector<char> varies;
};

FrameGaps compute_frame_gaps(const std::vector<Sample>& samples) {
    constexpr std::size_t kMost = 3000;
    std::vector<std::unique_ptr<SampleIndex>> frames;
    FrameGaps gaps;
    std::map<int, std::size_t> place;
    for (auto& [frame, of_frame] : group_by_frame(samples)) {
        place[frame] = frames.size();
        gaps.walked_m.push_back(samples[of_frame[of_frame.size() / 2]].walked_m);
        frames.push_back(std::make_unique<SampleIndex>(samples, std::move(of_frame)));
    }
    const std::size_t step = samples.size() / kMost + 1;
    for (std::size_t i = 0; i < samples.size(); i += step) gaps.frame.push_back(place[samples[i].frame]);
    gaps.distance_m.resize(gaps.frame.size());
    parallel_for(int(gaps.frame.size()), [&](int k) {
        for (const std::unique_ptr<SampleIndex>& frame : frames)
            gaps.distance_m[std::size_t(k)].push_back(
                float(frame->distance_m(samples[std::size_t(k) * step].position, kNearSurface_m)));
    });
    std::vector<double> spread;
    for (const std::vector<float>& distances : gaps.distance_m) {
        double sum = 0.0, sum2 = 0.0;
        for (const float d : distances) sum += d, sum2 += double(d) * d;
        spread.push_back(sum2 / double(distances.size()) - std::pow(sum / double(distances.size()), 2));
    }
    std::vector<double> sorted = spread;
    std::ranges::nth_element(sorted, sorted.begin() + std::ptrdiff_t(sorted.size() / 2));
    for (const double one : spread) gaps.varies.push_back(one >= sorted[sorted.size() / 2]);
    return gaps;
}

/// Rates a stride length. Returns a ratio: the mean distance between points of the same
/// gait phase, divided by the mean distance between points of different phases. The ratio
/// is about 1 for a wrong stride, and smaller for the right stride. Returns 2 if too few
/// frames have the same phase.
double compute_misfit_share(const FrameGaps& gaps, double stride_m) {
    // Two phases count as equal if they differ by less than kSame. They count as
    // different if they differ by more than kOther. Unit: strides.
    constexpr double kSame = 0.06, kOther = 0.15;
    constexpr double kWorst = 2.0;
    double same = 0.0, other = 0.0;
    std::size_t n_same = 0, n_other = 0;
    for (std::size_t k = 0; k < gaps.frame.size(); ++k) {
        if (!gaps.varies[k]) continue;
        for (std::size_t f = 0; f < gaps.walked_m.size(); ++f) {
            const double turns = (gaps.walked_m[f] - gaps.walked_m[gaps.frame[k]]) / stride_m,
                         off = std::abs(apart(0.0, turns));
            // Skips frames of the same stride. They are similar only because little time
            // has passed between them.
            if (std::abs(turns) < 0.5) continue;
            if (off < kSame) same += gaps.distance_m[k][f], ++n_same;
            if (off > kOther) other += gaps.distance_m[k][f], ++n_other;
        }
    }
    // Returns the worst value if there are too few pairs of a sample and a frame to
    // compare.
    if (n_same < gaps.frame.size() / 2 || n_other < gaps.frame.size() / 2) return kWorst;
    return same / double(n_same) / std::max(other / double(n_other), 1e-9);
}

}  // namespace

StrideEstimate find_stride(const std::vector<Sample>& samples, const StrideRange& range) {
    // Minimum number of samples and of frames. With fewer, a wrong stride can fit by
    // chance.
    constexpr std::size_t kFewest = 200, kFewestFrames = 24;
    constexpr double kClearly = 0.9, kStep = 1.01;
    constexpr std::size_t kBeside = 2;
    if (samples.size() < kFewest)
        return {0.0, fmt::format("the actor has only {} points, but detecting a gait needs at least {} "
                                 "points",
                                 samples.size(), kFewest)};
    const auto [first, last] = std::ranges::minmax(samples, {}, &Sample::walked_m);
    const double walked = double(last.walked_m) - double(first.walked_m),
                 most = std::min(range.most_m, walked / kTurns);
    if (most < range.least_m)
        return {0.0, fmt::format("the actor walked only {:.1f} m, but detecting a gait needs at least "
                                 "{:.1f} m",
                                 walked, kTurns * range.least_m)};
    const FrameGaps gaps = compute_frame_gaps(samples);
    if (gaps.walked_m.size() < kFewestFrames)
        return {0.0, fmt::format("the actor is observed in only {} frames, but detecting a gait needs at "
                                 "least {} frames",
                                 gaps.walked_m.size(), kFewestFrames)};
    std::vector<double> strides;
    for (double stride = range.least_m; stride <= most; stride *= kStep) strides.push_back(stride);
    std::vector<double> shares(strides.size()), smooth;
    parallel_for(int(strides.size()), [&](int index) {
        shares[std::size_t(index)] = compute_misfit_share(gaps, strides[std::size_t(index)]);
    });
    // Each share is the error of one candidate for the length of a stride. Averages the
    // shares of neighbouring candidates, because a single low error can be a coincidence.
    for (std::size_t i = kBeside; i + kBeside < shares.size(); ++i)
        smooth.push_back(std::accumulate(&shares[i - kBeside], &shares[i + kBeside] + 1, 0.0) /
                         (2 * kBeside + 1));
    if (smooth.size() < 3) return {0.0, "the actor walked too few strides"};
    const std::size_t best = std::size_t(std::ranges::min_element(smooth) - smooth.begin());
    const double stride = strides[best + kBeside];
    if (smooth[best] > kClearly || best == 0 || best + 1 == smooth.size())
        return {0.0, fmt::format(
                         "the points of the actor show no gait: the best stride length between {:.1f} and "
                         "{:.1f} m is {:.2f} m, but the distance between points of the same phase is {:.2f} "
                         "times the distance between other points, expected at most {} times",
                         strides.front(), strides.back(), stride, smooth[best], kClearly)};
    return {stride, {}};
}

namespace {

constexpr int kBins = 40;  // number of phase bins per stride
// Standard deviation of the phase interval in which a surfel is visible, in strides.
constexpr double kWindow = 0.06;
constexpr double kSame_m = 0.07;  // points that are closer together than this belong to the same surface

/// Samples of an actor, sorted into `kBins` bins by gait phase.
struct Phases {
    const std::vector<Sample>& samples;
    double stride_m;
    std::vector<std::unique_ptr<SampleIndex>> bins;

    Phases(const std::vector<Sample>& s, double stride) : samples(s), stride_m(stride) {
        std::vector<std::vector<std::uint32_t>> numbers(kBins);
        for (std::size_t i = 0; i < samples.size(); ++i)
            numbers[std::size_t(bin(of(i)))].push_back(std::uint32_t(i));
        for (std::vector<std::uint32_t>& of_bin : numbers)
            bins.push_back(std::make_unique<SampleIndex>(samples, std::move(of_bin)));
    }
    double of(std::size_t index) const { return turn(samples[index].walked_m / stride_m); }
    static int bin(double turns) { return std::min(kBins - 1, int(turn(turns) * kBins)); }
    const SampleIndex& at(int bin) const { return *bins[std::size_t((bin + kBins) % kBins)]; }
};

/// Returns true if at least three quarters of the gait phases have points near `point`.
/// Such a position does not move with the gait.
bool is_at_rest(const Phases& phases, const glm::vec3& point) {
    int seen = 0, filled = 0;
    for (int bin = 0; bin < kBins; ++bin) {
        if (phases.at(bin).cloud.of.empty()) continue;
        ++filled;
        if (phases.at(bin).distance_m(point, 2.0 * kSame_m) < kSame_m) ++seen;
    }
    return 4 * seen >= 3 * filled;
}

/// Estimates the velocity of the surface at a sample, in metres per stride. This velocity
/// moves the points around the sample onto the points of earlier and later phases.
glm::vec3 estimate_velocity_at(const Phases& phases, std::size_t index) {
    constexpr double kPatch_m = 0.12, kFar_m = 0.15;
    constexpr std::size_t kOfPatch = 6;
    const glm::vec3 p = phases.samples[index].position;
    const int bin = Phases::bin(phases.of(index));
    const std::vector<std::uint32_t> patch = phases.at(bin).within(p, kPatch_m, kOfPatch);
    glm::vec3 best(0.0f);
    double least = 1e9;
    for (float x = -3.2f; x <= 3.21f; x += 0.4f)
        for (float z = -0.8f; z <= 0.81f; z += 0.4f) {
            const glm::vec3 velocity(x, 0.0f, z);
            // Adds a small cost that grows with the speed. If several velocities fit
            // equally well, the slowest is chosen.
            double sum = 1e-4 * double(glm::length(velocity));
            for (const int ahead : {-4, -2, 2, 4}) {
                const SampleIndex& there = phases.at(bin + ahead);
                for (const std::uint32_t j : patch) {
                    const double turns = (bin + ahead + 0.5) / kBins - phases.of(j);
                    sum += there.distance_m(phases.samples[j].position + float(apart(0.0, turns)) * velocity,
                                            kFar_m);
                }
            }
            if (sum < least) least = sum, best = velocity;
        }
    return best;
}

/// Estimates the velocity at each sample. Replaces each velocity by the median of the
/// velocities nearby.
/// @param is_selected true for each sample whose velocity is computed
/// @return [samples] metres per stride
std::vector<glm::vec3> estimate_velocities(const Phases& phases, const std::vector<char>& is_selected,
                                           const Progress& progress) {
    constexpr double kAround_m = 0.15;
    constexpr std::size_t kMost = 9;
    const int n = int(is_selected.size());
    std::vector<glm::vec3> each(is_selected.size(), glm::vec3(0.0f)), middle = each;
    for_each_block_with_progress(is_selected.size(), progress, "steps of actors", [&](std::size_t index) {
        if (is_selected[index]) each[index] = estimate_velocity_at(phases, index);
    });
    parallel_for(n, [&](int number) {
        const std::size_t i = std::size_t(number);
        if (!is_selected[i]) return;
        const int bin = Phases::bin(phases.of(i));
        std::array<std::vector<float>, 3> around;
        for (const int beside : {-1, 0, 1})
            for (const std::uint32_t j :
                 phases.at(bin + beside).within(phases.samples[i].position, kAround_m, kMost))
                for (int k = 0; k < 3; ++k)
                    if (is_selected[j]) around[std::size_t(k)].push_back(each[j][k]);
        for (int k = 0; k < 3; ++k) {
            std::vector<float>& values = around[std::size_t(k)];
            const auto half = values.begin() + std::ptrdiff_t(values.size() / 2);
            std::nth_element(values.begin(), half, values.end());
            middle[i][k] = *half;  // not empty, because the list contains the sample itself
        }
    });
    return middle;
}

/// Makes one surfel for each sample. A surfel is visible around the gait phase of its
/// sample. If the sample does not move with the gait, its surfel is always visible.
Surfels make_surfels_with_gait(const std::vector<Sample>& samples, const std::vector<Gait>& gait,
                               const InitialiseOptions& options, double incidence) {
    std::vector<std::uint32_t> order;
    Surfels surfels = make_surfels_from_points(samples, options, incidence, {}, &order);
    surfels.add_gait();
    for (std::size_t i = 0; i < order.size(); ++i) surfels.gait[i] = gait[order[i]];
    return surfels;
}

}  // namespace

Surfels make_walking_surfels(const std::vector<Sample>& samples, double stride_m,
                             const InitialiseOptions& options, double incidence, std::size_t max_count,
                             const Progress& progress) {
    const Phases phases(samples, stride_m);
    std::vector<char> at_rest(samples.size());
    parallel_for(int(samples.size()), [&](int index) {
        at_rest[std::size_t(index)] = is_at_rest(phases, samples[std::size_t(index)].position);
    });
    std::vector<char> moves(at_rest);
    for (char& one : moves) one = !one;
    const std::vector<glm::vec3> velocity = estimate_velocities(phases, moves, progress);
    std::vector<Sample> resting;
    for (std::size_t i = 0; i < samples.size(); ++i)
        if (at_rest[i]) resting.push_back(samples[i]);
    Surfels surfels;
    if (!resting.empty()) {
        resting = thin_samples(resting, max_count / 2);
        surfels = make_surfels_with_gait(resting, std::vector<Gait>(resting.size()), options, incidence);
    }
    // number of neighbouring bins whose points are merged into one set of surfels
    constexpr int kTogether = 4;
    for (int first = 0; first < kBins; first += kTogether) {
        std::vector<std::uint32_t> numbers;
        for (int bin = first; bin < first + kTogether; ++bin)
            for (const std::uint32_t i : phases.at(bin).cloud.of)
                if (!at_rest[i]) numbers.push_back(i);
        std::vector<Gait> gait;
        for (const std::uint32_t i : numbers)
            gait.push_back(
                {float(phases.of(i)), float(1.0 / (2.0 * kPi * kWindow)), velocity[i] / float(2.0 * kPi)});
        // samples, each moved to its position at the middle phase of these bins
        std::vector<Sample> moving;
        const double middle = (first + 0.5 * kTogether) / kBins;
        for (std::size_t k = 0; k < numbers.size(); ++k) {
            moving.push_back(samples[numbers[k]]);
            moving.back().position +=
                float(std::sin(2.0 * kPi * apart(double(gait[k].phase), middle))) * gait[k].swing;
            gait[k].phase = float(middle);
        }
        std::vector<std::uint32_t> kept;
        const std::vector<Sample> thin = thin_samples(moving, max_count / 2 * kTogether / kBins, &kept);
        if (thin.empty()) continue;
        std::vector<Gait> of_kept;
        for (const std::uint32_t k : kept) of_kept.push_back(gait[k]);
        surfels.append(make_surfels_with_gait(thin, of_kept, options, incidence));
    }
    return surfels.reorder(compute_kd_order(surfels.mean));
}

}  // namespace relidar
