// SPDX-License-Identifier: Apache-2.0
// Corrections of the poses of one track, found by gradient descent: pose k becomes
// (exp([w_k]x) R_k, T_k + v_k), v in world metres, w a rotation vector in the world's
// axes about the pose's own origin. Between poses the track interpolates as ever, so a
// pose at fraction s moves, to first order, with (1 - s) of the correction before it and
// s of that after it.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// How one step is taken.
struct PoseStep {
    double rate_m = 0.0;
    double rate_rad = 0.0;
    double prior_per_m2 = 0.0;    ///< of prior |v|^2
    double prior_per_rad2 = 0.0;  ///< of prior |w|^2
};

class TrackCorrection {
public:
    explicit TrackCorrection(PoseTrack track);

    const PoseTrack& uncorrected() const { return track_; }
    /// Zero before the first step; between the corrections of the nearest poses that have
    /// been stepped where this one never was.
    Twist at(std::size_t pose) const;
    PoseTrack corrected() const;

    /// dL/d(v, w) of the track's pose at a time or of one of its poses, to be used by the
    /// next step.
    void add_gradient(double t_s, const Twist& gradient);
    void add_gradient(std::size_t pose, double share, const Twist& gradient);
    /// Adam on loss and prior, of the poses that were given a gradient since the last
    /// step.
    void step(const PoseStep& step);
    /// Takes out what all corrections have in common: a scene moved as a whole with all
    /// its sensors looks the same, so their common rigid motion is free and would drift.
    /// Afterwards mean translation and mean rotation are 0.
    void remove_common_motion();

    /// @param name of the track
    template <class Visitor>
    void visit_state(const std::string& name, Visitor&& visit) {
        visit(name + "/correction", values_);
        visit(name + "/moment1", moment1_);
        visit(name + "/moment2", moment2_);
        visit(name + "/steps", n_steps_);
    }
    /// Whether what was read back can be gone on with.
    bool is_sound() const;

private:
    PoseTrack track_;
    std::vector<double> values_, moment1_, moment2_;  ///< [poses,6]
    std::vector<std::uint64_t> n_steps_;              ///< [poses]
    std::vector<double> gradient_;                    ///< [poses,6] since the last step
    std::vector<bool> visited_;                       ///< [poses] since the last step

    Twist value(std::size_t pose) const;
};

}  // namespace relidar
