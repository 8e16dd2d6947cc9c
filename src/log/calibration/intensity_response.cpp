// SPDX-License-Identifier: Apache-2.0
// Estimates how intensities depend on range and incidence, and how the beams of a sensor
// differ. Compares returns from the same places (small cells). Minimises by Gauss-Newton
// the errors of this model, in which rho is a power of the range between two knots:
//   intensity = gain_b * albedo_p * rho(range) * (1 - q (1 - cos)) + offset_b
// The albedos are eliminated: H = sum J J^T - sum over places of (sum J c)(sum J c)^T /
// sum c^2. Here c is the derivative by the place's albedo. The model has two parts: range
// and incidence terms, and beam terms. If one part explains the data as well as both
// parts, only this part is used.
#include <algorithm>
#include <array>
#include <cmath>
#include <span>

#include <Eigen/Cholesky>

#include <relidar/log/calibration.hpp>
#include <relidar/log/log.hpp>

#include "base/parallel.hpp"
#include "log/calibration/beam_returns.hpp"

namespace relidar {
namespace {

// Ranges at which the intensity factor is fitted. Between them, the factor is a power of
// the range, which is exact if intensities are received powers.
constexpr std::array kKnots_m = {2.0, 4.0, 7.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 80.0, 120.0};
constexpr std::size_t kReferenceKnot = 3;  // index of the range at which the intensity factor is fixed to 1
// Weight of the prior in this fit, as a number of returns. The prior keeps beams with few
// returns similar to the mean beam. It also smooths the intensity factor over range.
constexpr double kResponsePrior = 200.0;
constexpr double kMinGain = 0.2, kMaxGain = 5.0, kMaxIncidence = 0.95;
// A log of received power has factors of (10 m / range)^2, from 25 at 2 m to 0.007 at
// 120 m. The limits are beyond these factors.
constexpr double kMinFactor = 0.001, kMaxFactor = 100.0;
// The intensity model has two parts: range and incidence terms, and beam terms. A part is
// used only if (RMS error with it / RMS error without it) is below this ratio.
constexpr double kMaxErrorRatio = 0.95;
constexpr int kFitSteps = 12;
constexpr double kDamping = 1e-3;
constexpr std::size_t kChunks = 64;  // number of partial sums, independent of the number of threads

struct BeamGainOffset {
    double gain = 1.0, offset = 0.0;
};

struct IntensityFit {
    std::vector<double> albedo;  ///< [cells]
    IntensityResponse shared{
        {kKnots_m.begin(), kKnots_m.end()}, std::vector<double>(kKnots_m.size(), 1.0), 0.0};
    std::vector<BeamGainOffset> beams;
    double rms = 0.0;
};

struct FittedTerms {
    bool shared, beams;
};

/// Calls process_cell_returns(returns, chunk) for each grid cell. `returns` are the
/// returns in the cell. The cells are divided into chunks, which run in parallel.
template <class Task>
void for_each_cell(const std::vector<CellReturn>& returns_sorted_by_cell, const Task& process_cell_returns) {
    const std::span all(returns_sorted_by_cell);
    // Returns the next border between two cells, which is `at` itself if it is a border.
    const auto find_cell_border = [&](std::size_t at) {
        while (at > 0 && at < all.size() && all[at].cell == all[at - 1].cell) ++at;
        return at;
    };
    parallel_for(static_cast<int>(kChunks), [&](int index) {
        const auto chunk = std::size_t(index);
        const std::size_t chunk_end = find_cell_border(all.size() * (chunk + 1) / kChunks);
        std::size_t begin = find_cell_border(all.size() * chunk / kChunks);
        while (begin < chunk_end) {
            const std::size_t end = find_cell_border(begin + 1);
            process_cell_returns(all.subspan(begin, end - begin), chunk);
            begin = end;
        }
    });
}

/// Computes the albedo (brightness) of the surface in each cell by least squares, with
/// all other variables fixed: intensity = albedo * x + offset, so
/// albedo = sum x (intensity - offset) / sum x^2, with x = gain * rho * kappa.
void fit_albedos(IntensityFit& model, const CellReturns& returns) {
    for_each_cell(returns.sorted_returns, [&](std::span<const CellReturn> cell_returns, std::size_t) {
        double xy = 0.0, xx = 0.0;
        for (const CellReturn& cell_return : cell_returns) {
            const BeamGainOffset& beam = model.beams[cell_return.beam];
            const double x = beam.gain * model.shared.range_factor(cell_return.range_m) *
                             model.shared.incidence_factor(cell_return.cosine);
            xy += x * (double(cell_return.intensity) - beam.offset);
            xx += x * x;
        }
        model.albedo[cell_returns.front().cell] = std::max(xy / std::max(xx, 1e-12), 0.0);
    });
}

/// Indices of the variables of the linear system: logarithm of the intensity factor at
/// each sampled range, incidence factor, then gain and offset of each beam.
struct VariableIndices {
    static constexpr auto kIncidence = Eigen::Index(kKnots_m.size());
    FittedTerms parts;
    std::size_t n_beams;

    /// The index of the offset is the next one.
    Eigen::Index gain_variable(std::size_t beam_index) const {
        return (parts.shared ? kIncidence + 1 : 0) + 2 * Eigen::Index(beam_index);
    }
    Eigen::Index size() const { return gain_variable(parts.beams ? n_beams : 0); }
};
/// Nonzero derivatives of the expected intensity of one return.
struct JacobianRow {
    std::array<std::pair<Eigen::Index, double>, 5> by;  ///< index of the variable, derivative
    std::size_t n = 0;                                  ///< number of entries of `by`
    double by_albedo;  ///< not in `by`, because the albedos are eliminated and have no index
    double error;      ///< measured minus expected intensity
};

/// Returns the knot before a range and the position between this knot (0) and the next
/// one (1). Outside all knots, it is the position of the first or the last knot.
std::pair<std::size_t, double> locate_range(double range_m) {
    const auto after = std::upper_bound(kKnots_m.begin(), kKnots_m.end(), range_m);
    const std::size_t knot = std::size_t(
        std::clamp<std::ptrdiff_t>(after - kKnots_m.begin() - 1, 0, std::ptrdiff_t(kKnots_m.size()) - 2));
    const double logarithm = std::log(range_m / kKnots_m[knot]);
    return {knot, std::clamp(logarithm / std::log(kKnots_m[knot + 1] / kKnots_m[knot]), 0.0, 1.0)};
}

/// Returns the derivatives and the error of one return by the model
///   intensity = gain * albedo * rho * kappa + offset
///   ln rho = (1 - s) ln factor[knot] + s ln factor[knot + 1],
///   kappa = 1 - incidence (1 - cosine)
/// where knot and s are the position of the range. Variables that are not fitted now have
/// no derivative.
JacobianRow jacobian_row(const IntensityFit& model, const VariableIndices& variables,
                         const CellReturn& measured) {
    const BeamGainOffset& beam = model.beams[measured.beam];
    const auto [knot, s] = locate_range(measured.range_m);
    const double rho = model.shared.range_factor(measured.range_m),
                 kappa = model.shared.incidence_factor(measured.cosine), albedo = model.albedo[measured.cell];
    const double intensity_at_gain_1 = albedo * rho * kappa;
    JacobianRow row{.by = {},
                    .n = 0,
                    .by_albedo = beam.gain * rho * kappa,
                    .error = double(measured.intensity) - beam.gain * intensity_at_gain_1 - beam.offset};
    const auto append = [&](Eigen::Index variable, double derivative) {
        row.by[row.n++] = {variable, derivative};
    };
    if (variables.parts.shared) {
        const auto factor = Eigen::Index(knot);  // variable k is the logarithm of factor k
        append(factor, beam.gain * intensity_at_gain_1 * (1.0 - s));
        append(factor + 1, beam.gain * intensity_at_gain_1 * s);
        append(VariableIndices::kIncidence, -beam.gain * albedo * rho * (1.0 - double(measured.cosine)));
    }
    if (variables.parts.beams) {
        const Eigen::Index gain = variables.gain_variable(measured.beam), offset = gain + 1;
        append(gain, intensity_at_gain_1);
        append(offset, 1.0);
    }
    return row;
}

struct NormalEquations {
    Eigen::MatrixXd h;  ///< lower half only
    Eigen::VectorXd g;
    /// mean and standard deviation of modelled intensities without BeamGainOffset::offset
    double mean = 0.0, spread = 0.0;
};

/// Partial sums of one thread for the normal equations. Aligned to cache lines, because
/// threads write to neighbouring elements.
struct alignas(64) Sums {
    NormalEquations system;
    // [unknowns] column of the albedo of the current grid cell
    std::vector<double> coupling;
    std::vector<Eigen::Index> touched;  // unknowns with a nonzero entry in `coupling`
    // Sum and sum of squares of the expected intensities, without the offsets of beams.
    double expected_sum = 0.0, expected_squares = 0.0;

    explicit Sums(Eigen::Index n)
        : system{Eigen::MatrixXd::Zero(n, n), Eigen::VectorXd::Zero(n)}, coupling(std::size_t(n), 0.0) {}

    /// Adds the returns of a cell, and eliminates its albedo (Schur complement).
    /// @param cell_returns all returns of the cell
    void add_cell(const IntensityFit& model, const VariableIndices& variable_indices,
                  std::span<const CellReturn> cell_returns) {
        double cc = 0.0, ce = 0.0;  // entries of the albedo in matrix and right-hand side
        touched.clear();
        for (const CellReturn& r : cell_returns) {
            const JacobianRow row = jacobian_row(model, variable_indices, r);
            for (std::size_t i = 0; i < row.n; ++i) {
                const auto [unknown, derivative] = row.by[i];
                if (coupling[std::size_t(unknown)] == 0.0) touched.push_back(unknown);
                coupling[std::size_t(unknown)] += derivative * row.by_albedo;
                system.g[unknown] += derivative * row.error;
                for (std::size_t j = 0; j <= i; ++j)
                    system.h(unknown, row.by[j].first) += derivative * row.by[j].second;
            }
            cc += row.by_albedo * row.by_albedo;
            ce += row.by_albedo * row.error;
            const double expected = model.albedo[r.cell] * row.by_albedo;
            expected_sum += expected;
            expected_squares += expected * expected;
        }
        for (const Eigen::Index i : touched) {
            system.g[i] -= coupling[std::size_t(i)] * ce / cc;
            for (const Eigen::Index j : touched)
                if (j <= i) system.h(i, j) -= coupling[std::size_t(i)] * coupling[std::size_t(j)] / cc;
        }
        for (const Eigen::Index i : touched) coupling[std::size_t(i)] = 0.0;
    }
};

/// Sums the normal equations over all cells, and computes mean and standard deviation of
/// the expected intensities. The sums have a fixed order, so they do not depend on the
/// number of threads.
NormalEquations build_equations(const IntensityFit& model, const VariableIndices& variable_indices,
                                const CellReturns& returns) {
    std::vector<Sums> chunk_sums(kChunks, Sums(variable_indices.size()));
    for_each_cell(returns.sorted_returns, [&](std::span<const CellReturn> cell_returns, std::size_t chunk) {
        chunk_sums[chunk].add_cell(model, variable_indices, cell_returns);
    });
    Sums& total = chunk_sums[0];
    for (std::size_t chunk = 1; chunk < kChunks; ++chunk) {
        total.system.h += chunk_sums[chunk].system.h;
        total.system.g += chunk_sums[chunk].system.g;
        total.expected_sum += chunk_sums[chunk].expected_sum;
        total.expected_squares += chunk_sums[chunk].expected_squares;
    }
    NormalEquations equations = std::move(total.system);
    const double n_returns = double(returns.sorted_returns.size());
    const double mean = total.expected_sum / n_returns;
    equations.mean = mean;
    // Variance = mean of the squares - square of the mean.
    equations.spread = std::sqrt(std::max(total.expected_squares / n_returns - mean * mean, 0.0));
    return equations;
}

/// Adds priors for variables that few returns determine.
void add_priors(NormalEquations& equations, const IntensityFit& model, const VariableIndices& indices) {
    // Adds a term weight (x_i - wanted value)^2. `error`: wanted minus current value
    const auto pull = [&](Eigen::Index i, double weight, double error) {
        equations.h(i, i) += weight;
        equations.g[i] += weight * error;
    };
    const double prior =
        kResponsePrior * (equations.mean * equations.mean + equations.spread * equations.spread);
    const auto log_factor = [&](std::size_t k) { return std::log(model.shared.factor[k]); };
    // If the intensity factor over range is fitted (`shared`), a prior smooths it. It
    // pulls the factor at range kKnots_m[k] towards the power of the range that the
    // factors k - 1 and k + 1 define. It matters only at ranges with few returns.
    for (std::size_t k = 1; indices.parts.shared && k + 1 < kKnots_m.size(); ++k) {
        const double before = std::log(kKnots_m[k] / kKnots_m[k - 1]),
                     after = std::log(kKnots_m[k + 1] / kKnots_m[k]);
        const Eigen::Vector3d factors(log_factor(k - 1), log_factor(k), log_factor(k + 1));
        // bend . factors: interpolated minus actual logarithm of factor k
        const Eigen::Vector3d bend = Eigen::Vector3d(after, -(before + after), before) / (before + after);
        const auto first = Eigen::Index(k - 1);
        equations.h.block<3, 3>(first, first) += prior * bend * bend.transpose();
        equations.g.segment<3>(first) -= prior * bend * bend.dot(factors);
    }
    if (indices.parts.shared) {
        // Doubling all albedos and halving all range factors gives the same intensities.
        // Therefore the range factor is fixed to 1 at one range.
        pull(kReferenceKnot, 1e3 * prior, -log_factor(kReferenceKnot));
        for (std::size_t k = 0; k < kKnots_m.size(); ++k) pull(Eigen::Index(k), 1e-6 * prior, -log_factor(k));
        pull(VariableIndices::kIncidence, 1e-3 * prior, -model.shared.incidence);
    }
    for (std::size_t b = 0; indices.parts.beams && b < model.beams.size(); ++b)
        // Pulls each beam to the mean beam with two virtual measurements, whose
        // intensities are typical: x should give gain * x + offset = x.
        for (const double x : {equations.mean - equations.spread, equations.mean + equations.spread}) {
            const double weight = 0.5 * kResponsePrior,
                         error = x - model.beams[b].gain * x - model.beams[b].offset;
            const Eigen::Index gain = indices.gain_variable(b);
            equations.h(gain, gain) += weight * x * x;
            equations.h(gain + 1, gain + 1) += weight;
            equations.h(gain + 1, gain) += weight * x;
            equations.g[gain] += weight * x * error;
            equations.g[gain + 1] += weight * error;
        }
}

/// Adds a solution of the normal equations to the variables, and limits them.
/// @param step  [variables] changes, at the positions of VariableIndices
void apply_step(IntensityFit& model, const VariableIndices& variable_indices, const Eigen::VectorXd& step) {
    IntensityResponse& shared = model.shared;
    if (variable_indices.parts.shared) {
        for (std::size_t k = 0; k < shared.factor.size(); ++k) {
            // Longer steps would overshoot, because the exponential is not linear.
            const double log_step = std::clamp(step[Eigen::Index(k)], -1.0, 1.0);
            shared.factor[k] = std::clamp(shared.factor[k] * std::exp(log_step), kMinFactor, kMaxFactor);
        }
        shared.incidence =
            std::clamp(shared.incidence + step[VariableIndices::kIncidence], 0.0, kMaxIncidence);
    }
    if (!variable_indices.parts.beams) return;
    for (std::size_t b = 0; b < model.beams.size(); ++b) {
        BeamGainOffset& beam = model.beams[b];
        const Eigen::Index gain = variable_indices.gain_variable(b), offset = gain + 1;
        beam.gain = std::clamp(beam.gain + step[gain], kMinGain, kMaxGain);
        beam.offset += step[offset];
    }
}

/// Scales and shifts all beams so that the mean beam (weighted by number of returns) has
/// gain 1 and offset 0. A common gain would look the same as brighter surfaces.
void normalise_beams(std::vector<BeamGainOffset>& beams, const CellReturns& returns) {
    std::vector<double> weights(beams.size(), kResponsePrior);
    for (const CellReturn& r : returns.sorted_returns) weights[r.beam] += 1.0;
    double weight_sum = 0.0, gain_sum = 0.0, offset_sum = 0.0;
    for (std::size_t b = 0; b < beams.size(); ++b) {
        weight_sum += weights[b];
        gain_sum += weights[b] * beams[b].gain;
        offset_sum += weights[b] * beams[b].offset;
    }
    // With x' = mean gain * x + mean offset, the intensity gain * x + offset of a beam is
    // (gain / mean gain) * (x' - mean offset) + offset.
    for (BeamGainOffset& beam : beams) {
        beam.gain *= weight_sum / gain_sum;
        beam.offset -= beam.gain * offset_sum / weight_sum;
    }
}

/// Returns the root mean square difference between measured and expected intensities.
double rms_error(const IntensityFit& model, const CellReturns& returns) {
    struct alignas(64) ChunkSum {  // a cache line each, because threads write to neighbouring sums
        double squares = 0.0;
    };
    std::array<ChunkSum, kChunks> sums;
    for_each_cell(returns.sorted_returns, [&](std::span<const CellReturn> cell_returns, std::size_t chunk) {
        for (const CellReturn& r : cell_returns) {
            const BeamGainOffset& beam = model.beams[r.beam];
            const double intensity_at_gain_1 = model.albedo[r.cell] * model.shared.range_factor(r.range_m) *
                                               model.shared.incidence_factor(r.cosine);
            const double error = beam.gain * intensity_at_gain_1 + beam.offset - double(r.intensity);
            sums[chunk].squares += error * error;
        }
    });
    double squares = 0.0;
    for (const ChunkSum& sum : sums) squares += sum.squares;
    return std::sqrt(squares / double(returns.sorted_returns.size()));
}

/// Fits the model by Levenberg-Marquardt steps. A step that increases the error is undone
/// and repeated with more damping.
/// @param terms_to_fit parts of the model; the other parts keep their neutral values
IntensityFit fit_intensity(const CellReturns& returns, std::size_t n_beams, FittedTerms terms_to_fit) {
    IntensityFit model;
    model.albedo.resize(returns.n_cells);
    model.beams.resize(n_beams);
    fit_albedos(model, returns);
    model.rms = rms_error(model, returns);
    const VariableIndices indices{terms_to_fit, n_beams};
    double damping = kDamping;
    for (int step = 0; step < kFitSteps && indices.size() > 0; ++step) {
        NormalEquations equations = build_equations(model, indices, returns);
        add_priors(equations, model, indices);
        equations.h.diagonal() *= 1.0 + damping;
        IntensityFit candidate = model;
        apply_step(candidate, indices, equations.h.ldlt().solve(equations.g));
        fit_albedos(candidate, returns);
        candidate.rms = rms_error(candidate, returns);
        const bool is_better = candidate.rms < model.rms;
        damping *= is_better ? 0.1 : 10.0;
        if (is_better) model = std::move(candidate);
    }
    if (terms_to_fit.beams) {
        normalise_beams(model.beams, returns);
        fit_albedos(model, returns);  // for the changed gains
    }
    return model;
}

}  // namespace

double IntensityResponse::range_factor(double distance_m) const {
    if (factor.empty()) return 1.0;
    const auto after = std::upper_bound(range_m.begin(), range_m.end(), distance_m);
    if (after == range_m.begin()) return factor.front();
    if (after == range_m.end()) return factor.back();
    const auto right = std::size_t(after - range_m.begin());
    const double s =
        std::log(distance_m / range_m[right - 1]) / std::log(range_m[right] / range_m[right - 1]);
    return factor[right - 1] * std::pow(factor[right] / factor[right - 1], s);
}

IntensityCalibrationResult calibrate_intensity(Log& log, const std::vector<int>& frames) {
    log.intensity_response = {};
    const std::vector<Beam*> beams = list_beams(log);
    for (Beam* beam : beams) {
        beam->intensity_gain = 1.0;
        beam->intensity_offset = 0.0;
    }
    const CellReturns returns = collect_cells(log, frames);
    IntensityCalibrationResult result;
    result.returns = returns.sorted_returns.size();
    if (returns.sorted_returns.empty()) return result;
    const std::size_t n = beams.size();
    const auto is_clearly_better = [](const IntensityFit& complex, const IntensityFit& simple) {
        return complex.rms < kMaxErrorRatio * simple.rms;
    };
    // Compares fits with neither part, each, and both. More terms must clearly help.
    IntensityFit best = fit_intensity(returns, n, {.shared = false, .beams = false});
    result.rms_before = best.rms;
    const IntensityFit shared = fit_intensity(returns, n, {.shared = true, .beams = false}),
                       each_beam = fit_intensity(returns, n, {.shared = false, .beams = true}),
                       both = fit_intensity(returns, n, {.shared = true, .beams = true});
    const bool is_shared_better = shared.rms <= each_beam.rms;
    const IntensityFit& single = is_shared_better ? shared : each_beam;
    if (is_clearly_better(single, best)) {
        best = single;
        result.shared = is_shared_better;
        result.beams = !is_shared_better;
    }
    if (is_clearly_better(both, best)) {
        best = both;
        result.shared = result.beams = true;
    }
    result.rms_after = best.rms;
    if (result.shared) log.intensity_response = best.shared;
    for (std::size_t b = 0; b < n && result.beams; ++b) {
        beams[b]->intensity_gain = best.beams[b].gain;
        beams[b]->intensity_offset = best.beams[b].offset;
    }
    return result;
}

}  // namespace relidar
