// SPDX-License-Identifier: Apache-2.0
// Estimates how intensities depend on range and incidence, and how the beams of a sensor
// differ. Compares returns from the same places (small cells). Minimises by Gauss-Newton
// the errors of
//   intensity = gain_b * albedo_p * rho(range) * (1 - q (1 - cos)) + offset_b,   rho piecewise linear.
// The albedos are eliminated: H = sum J J^T - sum over places of (sum J c)(sum J c)^T /
// sum c^2. Here c is the derivative with respect to the place's albedo. The model has two
// parts: the range and incidence terms, and the beam terms. If one part explains the data
// as well as both parts, only this part is used.
#include <algorithm>
#include <array>
#include <cmath>
#include <span>

#include <Eigen/Cholesky>

#include <relidar/log/sequence.hpp>

#include "base/parallel.hpp"
#include "log/sequence/beam_returns.hpp"
#include "log/sequence/intensity_places.hpp"

namespace relidar {
namespace {

constexpr std::array kKnots_m = {2.0, 4.0, 7.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 80.0, 120.0};
constexpr std::size_t kReference = 3;  // index of the knot where rho is 1
// Weight of the prior, as a number of returns. The prior pulls each beam towards the mean
// beam. It also pulls rho, the factor at a range, towards a straight line through the
// neighbouring knots.
constexpr double kResponsePrior = 200.0;
constexpr double kMinGain = 0.2, kMaxGain = 5.0, kMinFactor = 0.05, kMaxFactor = 20.0, kMaxIncidence = 0.95;
// A part of the model is used only if it reduces the error to less than this ratio.
constexpr double kLeastResponseGain = 0.95;
constexpr int kSteps = 12;
constexpr double kDamping = 1e-3;
constexpr std::size_t kChunks = 64;  // number of partial sums, independent of the number of threads

struct Response {
    double gain = 1.0;
    double offset = 0.0;
};

struct Model {
    std::vector<double> albedo;  ///< [places]
    IntensityResponse shared{
        {kKnots_m.begin(), kKnots_m.end()}, std::vector<double>(kKnots_m.size(), 1.0), 0.0};
    std::vector<Response> beams;
    double rms = 0.0;
};

struct Parts {
    bool shared, beams;
};

/// Returns the index of the knot (sampled range) before a range, and the position between
/// this knot and the next as a fraction. The fraction is clamped to 0 .. 1.
std::pair<std::size_t, double> find_knot(double range_m) {
    const auto after = std::upper_bound(kKnots_m.begin(), kKnots_m.end(), range_m);
    const std::size_t left = std::size_t(
        std::clamp<std::ptrdiff_t>(after - kKnots_m.begin() - 1, 0, std::ptrdiff_t(kKnots_m.size()) - 2));
    return {left, std::clamp((range_m - kKnots_m[left]) / (kKnots_m[left + 1] - kKnots_m[left]), 0.0, 1.0)};
}

/// Divides returns into chunks for parallel sums, without splitting the returns of a
/// place (small cell). Returns the first index of each chunk, and the number of returns.
std::vector<std::size_t> divide_into_chunks(const std::vector<PlaceReturn>& returns) {
    std::vector<std::size_t> bounds{0};
    for (std::size_t c = 1; c < kChunks; ++c) {
        std::size_t at = std::max(returns.size() * c / kChunks, bounds.back());
        while (at > 0 && at < returns.size() && returns[at].place == returns[at - 1].place) ++at;
        bounds.push_back(at);
    }
    bounds.push_back(returns.size());
    return bounds;
}

/// Calls task(returns, chunk) for the returns of each place (small cell), in parallel by
/// chunk.
template <class Task>
void for_each_place_in_parallel(const std::vector<PlaceReturn>& returns, const Task& task) {
    const std::vector<std::size_t> bounds = divide_into_chunks(returns);
    parallel_for(static_cast<int>(kChunks), [&](int chunk) {
        const std::size_t last = bounds[std::size_t(chunk) + 1];
        for (std::size_t begin = bounds[std::size_t(chunk)], end = begin; begin < last; begin = end) {
            while (end < last && returns[end].place == returns[begin].place) ++end;
            task(std::span(returns).subspan(begin, end - begin), std::size_t(chunk));
        }
    });
}

void fit_albedos(Model& model, const PlaceReturns& returns) {
    for_each_place_in_parallel(returns.seen, [&](std::span<const PlaceReturn> place, std::size_t) {
        double sum = 0.0, weight = 0.0;
        for (const PlaceReturn& r : place) {
            const Response& beam = model.beams[r.beam];
            const double x = beam.gain * model.shared.at_range(r.range_m) * model.shared.at_cosine(r.cosine);
            sum += x * (double(r.intensity) - beam.offset);
            weight += x * x;
        }
        model.albedo[place.front().place] = std::max(sum / std::max(weight, 1e-12), 0.0);
    });
}

/// Index of each unknown in the linear system: rho at the knots, q (effect of incidence),
/// then gain and offset of each beam.
struct Layout {
    Parts parts;
    std::size_t n_beams;
    Eigen::Index factor(std::size_t knot) const { return Eigen::Index(knot); }
    Eigen::Index incidence() const { return Eigen::Index(kKnots_m.size()); }
    Eigen::Index gain(std::size_t beam) const {
        return (parts.shared ? incidence() + 1 : 0) + 2 * Eigen::Index(beam);
    }
    Eigen::Index offset(std::size_t beam) const { return gain(beam) + 1; }
    Eigen::Index size() const { return gain(parts.beams ? n_beams : 0); }
};

/// Nonzero derivatives of the expected intensity of one return with respect to the
/// unknowns, in ascending order of the unknowns.
struct Row {
    std::array<std::pair<Eigen::Index, double>, 5> by;
    std::size_t n = 0;
    /// derivative with respect to the albedo of the place, and measured minus expected
    /// intensity
    double by_albedo, error;
    void add(Eigen::Index unknown, double derivative) { by[n++] = {unknown, derivative}; }
};

Row make_response_row(const Model& model, const Layout& layout, const PlaceReturn& place_return) {
    const Response& beam = model.beams[place_return.beam];
    const auto [knot, s] = find_knot(place_return.range_m);
    const double rho = model.shared.at_range(place_return.range_m),
                 kappa = model.shared.at_cosine(place_return.cosine),
                 albedo = model.albedo[place_return.place], mean_beam = albedo * rho * kappa;
    Row row{
        {}, 0, beam.gain * rho * kappa, double(place_return.intensity) - beam.gain * mean_beam - beam.offset};
    if (layout.parts.shared) {
        row.add(layout.factor(knot), beam.gain * albedo * kappa * (1.0 - s));
        row.add(layout.factor(knot + 1), beam.gain * albedo * kappa * s);
        row.add(layout.incidence(), -beam.gain * albedo * rho * (1.0 - double(place_return.cosine)));
    }
    if (layout.parts.beams) {
        row.add(layout.gain(place_return.beam), mean_beam);
        row.add(layout.offset(place_return.beam), 1.0);
    }
    return row;
}

struct System {
    Eigen::MatrixXd h;  ///< lower half only
    Eigen::VectorXd g;
    /// mean and standard deviation of the expected intensities, without the beam offsets
    double mean = 0.0, spread = 0.0;
};

/// Sums over the places (small cells) of a chunk. Only the lower half of the symmetric
/// matrix h is used. Aligned to cache lines, because threads write to neighbouring sums.
struct alignas(64) Sums {
    System system;
    // [unknowns] sums of products: derivative by the albedo times derivative by the
    // unknown, for the current place; zero between places
    std::vector<double> coupling;
    std::vector<Eigen::Index> touched;  // unknowns that are coupled to the current place
    double sum = 0.0, squares = 0.0;    // sum and sum of squares of the expected intensities

    explicit Sums(Eigen::Index n)
        : system{Eigen::MatrixXd::Zero(n, n), Eigen::VectorXd::Zero(n)}, coupling(std::size_t(n), 0.0) {}

    void add(const Model& model, const Layout& layout, std::span<const PlaceReturn> place) {
        double cc = 0.0, ce = 0.0;
        touched.clear();
        for (const PlaceReturn& r : place) {
            const Row row = make_response_row(model, layout, r);
            for (std::size_t i = 0; i < row.n; ++i) {
                const auto [unknown, derivative] = row.by[i];
                if (coupling[std::size_t(unknown)] == 0.0) touched.push_back(unknown);
                coupling[std::size_t(unknown)] += derivative * row.by_albedo;
                system.g[unknown] += derivative * row.error;
                for (std::size_t j = 0; j <= i; ++j)
                    system.h(unknown, row.by[j].first) += derivative * row.by[j].second;
            }
            cc += row.by_albedo * row.by_albedo, ce += row.by_albedo * row.error;
            const double expected = model.albedo[r.place] * row.by_albedo;
            sum += expected, squares += expected * expected;
        }
        for (const Eigen::Index i : touched) {
            system.g[i] -= coupling[std::size_t(i)] * ce / cc;
            for (const Eigen::Index j : touched)
                if (j <= i) system.h(i, j) -= coupling[std::size_t(i)] * coupling[std::size_t(j)] / cc;
        }
        for (const Eigen::Index i : touched) coupling[std::size_t(i)] = 0.0;
    }
};

System build_system(const Model& model, const Layout& layout, const PlaceReturns& returns) {
    std::vector<Sums> sums(kChunks, Sums(layout.size()));
    for_each_place_in_parallel(returns.seen, [&](std::span<const PlaceReturn> place, std::size_t chunk) {
        sums[chunk].add(model, layout, place);
    });
    for (std::size_t c = 1; c < kChunks; ++c) {
        sums[0].system.h += sums[c].system.h, sums[0].system.g += sums[c].system.g;
        sums[0].sum += sums[c].sum, sums[0].squares += sums[c].squares;
    }
    System sys = std::move(sums[0].system);
    const double n = double(returns.seen.size());
    sys.mean = sums[0].sum / n;
    sys.spread = std::sqrt(std::max(sums[0].squares / n - sys.mean * sys.mean, 0.0));
    return sys;
}

void add_priors(System& sys, const Model& model, const Layout& layout) {
    const auto pull = [&](Eigen::Index i, double weight, double error) {
        sys.h(i, i) += weight, sys.g[i] += weight * error;
    };
    const double prior = kResponsePrior * (sys.mean * sys.mean + sys.spread * sys.spread);
    // The prior pulls rho at knots with few returns to the line through the neighbouring
    // knots.
    for (std::size_t k = 1; layout.parts.shared && k + 1 < kKnots_m.size(); ++k) {
        const double before = kKnots_m[k] - kKnots_m[k - 1], after = kKnots_m[k + 1] - kKnots_m[k];
        const Eigen::Vector3d bend = Eigen::Vector3d(after, -(before + after), before) / (before + after),
                              now(model.shared.factor[k - 1], model.shared.factor[k],
                                  model.shared.factor[k + 1]);
        sys.h.block<3, 3>(layout.factor(k - 1), layout.factor(k - 1)) += prior * bend * bend.transpose();
        sys.g.segment<3>(layout.factor(k - 1)) -= prior * bend * bend.dot(now);
    }
    if (layout.parts.shared) {
        // A common scale of all albedos cannot be observed, so rho is fixed to 1 at one
        // knot.
        pull(layout.factor(kReference), 1e3 * prior, 1.0 - model.shared.factor[kReference]);
        for (std::size_t k = 0; k < kKnots_m.size(); ++k)
            pull(layout.factor(k), 1e-3 * prior, 1.0 - model.shared.factor[k]);
        pull(layout.incidence(), 1e-3 * prior, -model.shared.incidence);
    }
    for (std::size_t b = 0; layout.parts.beams && b < model.beams.size(); ++b)
        for (const double x : {sys.mean - sys.spread, sys.mean + sys.spread}) {
            const double weight = 0.5 * kResponsePrior,
                         error = x - model.beams[b].gain * x - model.beams[b].offset;
            sys.h(layout.gain(b), layout.gain(b)) += weight * x * x,
                sys.h(layout.offset(b), layout.offset(b)) += weight;
            sys.h(layout.offset(b), layout.gain(b)) += weight * x;
            sys.g[layout.gain(b)] += weight * x * error, sys.g[layout.offset(b)] += weight * error;
        }
}

void apply_step(Model& model, const Layout& layout, const Eigen::VectorXd& step) {
    if (layout.parts.shared) {
        for (std::size_t k = 0; k < model.shared.factor.size(); ++k)
            model.shared.factor[k] =
                std::clamp(model.shared.factor[k] + step[layout.factor(k)], kMinFactor, kMaxFactor);
        model.shared.incidence =
            std::clamp(model.shared.incidence + step[layout.incidence()], 0.0, kMaxIncidence);
    }
    for (std::size_t b = 0; layout.parts.beams && b < model.beams.size(); ++b) {
        model.beams[b].gain = std::clamp(model.beams[b].gain + step[layout.gain(b)], kMinGain, kMaxGain);
        model.beams[b].offset += step[layout.offset(b)];
    }
}

/// Normalises the beams so that their mean, weighted by numbers of returns, has gain 1
/// and offset 0. A common scale and shift of all albedos cannot be observed anyway.
void normalise_mean_beam(std::vector<Response>& beams, const PlaceReturns& returns) {
    std::vector<double> n(beams.size(), kResponsePrior);
    for (const PlaceReturn& r : returns.seen) n[r.beam] += 1.0;
    double all = 0.0, gain = 0.0, offset = 0.0;
    for (std::size_t b = 0; b < beams.size(); ++b)
        all += n[b], gain += n[b] * beams[b].gain, offset += n[b] * beams[b].offset;
    for (Response& r : beams) {
        r.gain *= all / gain;
        r.offset -= r.gain * offset / all;
    }
}

double compute_error(const Model& model, const PlaceReturns& returns) {
    struct alignas(64) Sum {  // one cache line per sum, because threads write to neighbouring elements
        double of = 0.0;
    };
    std::array<Sum, kChunks> squares;
    for_each_place_in_parallel(returns.seen, [&](std::span<const PlaceReturn> place, std::size_t chunk) {
        for (const PlaceReturn& r : place) {
            const Response& beam = model.beams[r.beam];
            const double mean_beam = model.albedo[r.place] * model.shared.at_range(r.range_m) *
                                     model.shared.at_cosine(r.cosine),
                         error = beam.gain * mean_beam + beam.offset - double(r.intensity);
            squares[chunk].of += error * error;
        }
    });
    double all = 0.0;
    for (const Sum& sum : squares) all += sum.of;
    return std::sqrt(all / double(returns.seen.size()));
}

Model fit_response(const PlaceReturns& returns, std::size_t n_beams, Parts parts) {
    Model m;
    m.albedo.resize(returns.n_places);
    m.beams.resize(n_beams);
    fit_albedos(m, returns);
    m.rms = compute_error(m, returns);
    const Layout at{parts, n_beams};
    double damping = kDamping;
    for (int i = 0; i < kSteps && at.size() > 0; ++i) {  // Levenberg-Marquardt
        System sys = build_system(m, at, returns);
        add_priors(sys, m, at);
        sys.h.diagonal() *= 1.0 + damping;
        Model next = m;
        apply_step(next, at, sys.h.ldlt().solve(sys.g));
        fit_albedos(next, returns);
        next.rms = compute_error(next, returns);
        const bool is_better = next.rms < m.rms;
        damping *= is_better ? 0.1 : 10.0;
        if (is_better) m = std::move(next);
    }
    if (parts.beams) {
        normalise_mean_beam(m.beams, returns);
        fit_albedos(m, returns);
    }
    return m;
}

}  // namespace

double IntensityResponse::at_range(double at_m) const {
    if (factor.empty()) return 1.0;
    const auto after = std::upper_bound(range_m.begin(), range_m.end(), at_m);
    if (after == range_m.begin()) return factor.front();
    if (after == range_m.end()) return factor.back();
    const auto right = std::size_t(after - range_m.begin());
    const double s = (at_m - range_m[right - 1]) / (range_m[right] - range_m[right - 1]);
    return (1.0 - s) * factor[right - 1] + s * factor[right];
}

IntensityCalibration calibrate_intensity(Sequence& sequence, const std::vector<int>& positions) {
    sequence.intensity_response = {};
    const std::vector<Beam*> beams = list_beams(sequence);
    for (Beam* beam : beams) beam->intensity_gain = 1.0, beam->intensity_offset = 0.0;
    const PlaceReturns returns = collect_place_returns(sequence, positions);
    IntensityCalibration result;
    result.returns = returns.seen.size();
    if (returns.seen.empty()) return result;
    const std::size_t n = beams.size();
    const auto better = [](const Model& first, const Model& second) {
        return first.rms < kLeastResponseGain * second.rms;
    };
    Model best = fit_response(returns, n, {false, false});
    result.rms_before = best.rms;
    const Model shared = fit_response(returns, n, {true, false}),
                each_beam = fit_response(returns, n, {false, true}),
                both = fit_response(returns, n, {true, true});
    const bool first_shared = shared.rms <= each_beam.rms;
    const Model& single = first_shared ? shared : each_beam;
    if (better(single, best)) best = single, result.shared = first_shared, result.beams = !first_shared;
    if (better(both, best)) best = both, result.shared = result.beams = true;
    result.rms_after = best.rms;
    if (result.shared) sequence.intensity_response = best.shared;
    for (std::size_t b = 0; b < n && result.beams; ++b) {
        beams[b]->intensity_gain = best.beams[b].gain;
        beams[b]->intensity_offset = best.beams[b].offset;
    }
    return result;
}

}  // namespace relidar
