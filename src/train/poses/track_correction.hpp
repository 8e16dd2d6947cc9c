// SPDX-License-Identifier: Apache-2.0
// Corrects the poses of a track by gradient descent. Pose k becomes (exp([w_k]x) R_k, T_k
// + v_k). v is in metres in the world frame. w is a rotation vector in the world's axes
// about the origin of the pose. Poses at other times are interpolated. To first order, a
// pose at a fraction s of the way to the next pose moves by (1 - s) times the previous
// correction plus s times the next correction.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {

struct PoseStepRates {
    double rate_m = 0.0;
    double rate_rad = 0.0;
    double prior_per_m2 = 0.0;    ///< weight of the prior |v|^2
    double prior_per_rad2 = 0.0;  ///< weight of the prior |w|^2
};

class TrackCorrection {
public:
    explicit TrackCorrection(PoseTrack track);

    const PoseTrack& uncorrected_track() const { return track_; }
    /// Interpolates between the nearest optimised poses if the pose was not optimised
    /// yet. Zero if no pose was optimised.
    Twist correction_at(std::size_t pose) const;
    PoseTrack corrected_track() const;

    /// Adds a loss gradient dL/d(v, w) of the pose at any time, or of a recorded pose.
    /// The next run_adam_step() uses the sum.
    void add_gradient(double t_s, const Twist& gradient);
    void add_gradient(std::size_t pose, double weight, const Twist& gradient);
    /// Performs an Adam step. Changes only poses that got a gradient after the last step.
    void run_adam_step(const PoseStepRates& step_rates);
    /// Removes the rigid motion that all corrections have in common, which the loss does
    /// not constrain. Afterwards, the mean translation and rotation are 0.
    void remove_mean_motion();

    template <class Visitor>
    void visit_state(const std::string& name, Visitor&& visit) {
        visit(name + "/correction", values_);
        visit(name + "/moment1", moment1_);
        visit(name + "/moment2", moment2_);
        visit(name + "/steps", n_steps_);
    }

private:
    PoseTrack track_;
    std::vector<double> values_, moment1_, moment2_;  ///< [poses,6]
    std::vector<std::uint64_t> n_steps_;              ///< [poses] number of steps
    std::vector<double> gradient_;                    ///< [poses,6] sum of the gradients since the last step
    std::vector<bool> visited_;  ///< [poses] true if a gradient was added since the last step

    Twist stored_correction(std::size_t pose) const;
};

}  // namespace relidar
