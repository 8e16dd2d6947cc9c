// SPDX-License-Identifier: Apache-2.0
// Intensity responses of the lasers of one sensor, from how differently they see the same places (alternating least squares).
#include <algorithm>
#include <cmath>
#include <unordered_map>

#include <relidar/sequence.hpp>

#include "core/cell_key.hpp"
#include "sequence/laser_returns.hpp"

namespace relidar {
namespace {

constexpr double kCell_m = 0.1;             // a place: small enough to be one surface, large enough to be hit by several lasers
constexpr double kMaxRange_m = 50.0;        // farther out a place is seldom hit twice
constexpr std::size_t kMostReturns = 8000000;
constexpr double kPriorReturns = 200.0;     // a laser starts as if so many of its returns had followed the mean laser
constexpr double kMinGain = 0.2, kMaxGain = 5.0;
constexpr int kRounds = 20;

/// One return: where, by which laser, how bright.
struct Observation {
    std::uint32_t place;
    std::uint32_t beam;
    float intensity;
};

/// Returns of one frame; `place` is still to be numbered.
struct FrameReturns {
    std::vector<std::uint64_t> cell;
    std::vector<Observation> seen;
};

FrameReturns returns_of(const Sequence& sequence, const Frame& frame) {
    FrameReturns result;
    const Scan& scan = frame.scan;
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        if (!is_of_laser(sequence, scan, ray, kMaxRange_m)) continue;
        result.cell.push_back(cell_key(world_return(sequence, frame, ray).point_m, kCell_m));
        result.seen.push_back({0, scan.rays.channel[ray], scan.intensity[ray]});
    }
    return result;
}

/// Returns of places that at least two lasers have seen, places numbered from 0.
std::vector<Observation> shared_places(const Sequence& sequence, const std::vector<int>& positions, std::size_t& n_places) {
    std::vector<FrameReturns> frames = read_frames(sequence, positions, kMostReturns, [&](const Frame& frame) { return returns_of(sequence, frame); });

    constexpr std::uint32_t kSeveral = 0xffffffffu;
    std::unordered_map<std::uint64_t, std::uint32_t> number;
    std::vector<std::uint32_t> only_beam;
    for (FrameReturns& frame : frames)
        for (std::size_t k = 0; k < frame.cell.size(); ++k) {
            const auto [slot, is_new] = number.try_emplace(frame.cell[k], static_cast<std::uint32_t>(only_beam.size()));
            Observation& o = frame.seen[k];
            o.place = slot->second;
            if (is_new) only_beam.push_back(o.beam);
            else if (only_beam[o.place] != o.beam) only_beam[o.place] = kSeveral;
        }
    n_places = only_beam.size();
    std::vector<Observation> shared;
    for (const FrameReturns& frame : frames)
        std::copy_if(frame.seen.begin(), frame.seen.end(), std::back_inserter(shared), [&](const Observation& o) { return only_beam[o.place] == kSeveral; });
    return shared;
}

struct Response {
    double gain = 1.0;
    double offset = 0.0;
};

/// Brightness of each place under the present responses: least squares.
std::vector<double> brightness_of_places(const std::vector<Observation>& seen, const std::vector<Response>& responses, std::size_t n_places) {
    std::vector<double> sum(n_places, 0.0), weight(n_places, 0.0);
    for (const Observation& o : seen) {
        const Response& r = responses[o.beam];
        sum[o.place] += r.gain * (double(o.intensity) - r.offset);
        weight[o.place] += r.gain * r.gain;
    }
    for (std::size_t i = 0; i < n_places; ++i) sum[i] /= std::max(weight[i], 1e-12);
    return sum;
}

/// Sums of a straight line's least squares.
struct LineFit {
    double n = 0.0, x = 0.0, y = 0.0, xx = 0.0, xy = 0.0;
    void add(double at, double value, double times = 1.0) { n += times, x += times * at, y += times * value, xx += times * at * at, xy += times * at * value; }
    Response response() const {
        const double variance = n * xx - x * x;
        if (!(variance > 1e-12 * n * n)) return {};
        const double gain = std::clamp((n * xy - x * y) / variance, kMinGain, kMaxGain);
        return {gain, (y - gain * x) / n};
    }
};

/// One scale and one shift of all brightnesses are free: the mean laser, by returns, has gain 1 and offset 0.
void fix_mean(std::vector<Response>& responses, const std::vector<LineFit>& fits) {
    double n = 0.0, gain = 0.0, offset = 0.0;
    for (std::size_t b = 0; b < responses.size(); ++b) n += fits[b].n, gain += fits[b].n * responses[b].gain, offset += fits[b].n * responses[b].offset;
    for (Response& r : responses) {
        r.gain *= n / gain;
        r.offset -= r.gain * offset / n;
    }
}

/// Each laser's line of intensity over brightness. @return the mean square error of the responses that come in
double fit_responses(const std::vector<Observation>& seen, const std::vector<double>& brightness, std::vector<Response>& responses) {
    double squares = 0.0, sum = 0.0, sum2 = 0.0;
    std::vector<LineFit> fits(responses.size());
    for (const Observation& o : seen) {
        const double at = brightness[o.place], error = responses[o.beam].gain * at + responses[o.beam].offset - double(o.intensity);
        squares += error * error, sum += at, sum2 += at * at;
        fits[o.beam].add(at, double(o.intensity));
    }
    const double n = double(seen.size()), mean = sum / n, spread = std::sqrt(std::max(sum2 / n - mean * mean, 0.0));
    for (LineFit& fit : fits)
        for (const double at : {mean - spread, mean + spread}) fit.add(at, at, 0.5 * kPriorReturns);
    for (std::size_t b = 0; b < responses.size(); ++b) responses[b] = fits[b].response();
    fix_mean(responses, fits);
    return squares / n;
}

}  // namespace

LaserCalibration calibrate_intensity(Sequence& sequence, const std::vector<int>& positions) {
    for (Beam& beam : sequence.sensor.beams) beam.intensity_gain = 1.0, beam.intensity_offset = 0.0;
    std::size_t n_places = 0;
    const std::vector<Observation> seen = shared_places(sequence, positions, n_places);
    LaserCalibration result{seen.size(), 0.0, 0.0, !seen.empty()};
    if (seen.empty()) return result;
    std::vector<Response> responses(sequence.sensor.beams.size());
    for (int round = 0; round < kRounds; ++round) {
        const std::vector<double> brightness = brightness_of_places(seen, responses, n_places);
        result.rms_after = std::sqrt(fit_responses(seen, brightness, responses));
        if (round == 0) result.rms_before = result.rms_after;
    }
    for (std::size_t b = 0; b < responses.size(); ++b) {
        sequence.sensor.beams[b].intensity_gain = responses[b].gain;
        sequence.sensor.beams[b].intensity_offset = responses[b].offset;
    }
    return result;
}

float surface_intensity(const SpinningSensor& sensor, const Scan& scan, std::size_t ray) {
    const Beam& beam = laser_of(sensor.beams, scan.rays.channel[ray]);
    return static_cast<float>((double(scan.intensity[ray]) - beam.intensity_offset) / beam.intensity_gain);
}

}  // namespace relidar
