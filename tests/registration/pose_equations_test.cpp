// SPDX-License-Identifier: Apache-2.0
// Compares the Gauss-Newton step with the dense problem: unknowns for poses and planes, a
// row per point.
#include <random>

#include <gtest/gtest.h>
#include <Eigen/Dense>

#include "registration/pose_equations.hpp"

namespace relidar {
namespace {

constexpr int kPoses = 7, kPointsAPlane = 40;

struct Problem {
    PoseTrack track;
    std::vector<SubsampledPoint> points;
    std::vector<WorldPointWithOrigin> placed;
    /// planes that were fitted with weights that differ from the weights in the equations
    std::vector<LocalPlane> planes;
    std::vector<std::vector<std::uint32_t>> members;  ///< [planes]
    double scale_m = 0.1;
};

LocalPlane make_plane_through(const glm::dvec3& at_m, const glm::dvec3& normal) {
    const glm::dvec3 n = glm::normalize(normal), u = glm::normalize(glm::cross(n, glm::dvec3(0.3, 0.5, 0.8)));
    return {at_m, n, u, glm::cross(n, u)};
}

/// A third of the points deviates by a kernel width or more.
Problem make_random_problem(unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> uniform(-1.0, 1.0);
    Problem p;
    for (int k = 0; k <= kPoses; ++k) {
        p.track.time_s.push_back(0.1 * k);
        const glm::dquat rotation(1.0, 0.02 * uniform(random), 0.02 * uniform(random), 0.1 * k);
        p.track.pose.push_back({glm::normalize(rotation), {1.0 * k, 0.1 * k, 0.0}});
    }
    for (int i = 0; i < 60; ++i) {
        const glm::dvec3 centre(10.0 * uniform(random), 10.0 * uniform(random), 3.0 * uniform(random));
        const LocalPlane plane =
            make_plane_through(centre, {uniform(random), uniform(random), uniform(random)});
        std::vector<std::uint32_t>& members = p.members.emplace_back();
        for (int k = 0; k < kPointsAPlane; ++k) {
            const double off_m = k % 3 == 0 ? 0.3 * uniform(random) : 0.02 * uniform(random);
            const glm::dvec3 at =
                centre + uniform(random) * plane.u + 0.4 * uniform(random) * plane.v + off_m * plane.normal;
            SubsampledPoint point;
            point.left = std::uint32_t(k % kPoses);
            point.s = 0.5f * float(uniform(random) + 1.0);
            point.pose = point.left;
            const glm::dvec3 sensor_m = p.track.pose_at(0.1 * (point.left + double(point.s))).translation;
            members.push_back(std::uint32_t(p.points.size()));
            p.points.push_back(point);
            p.placed.push_back({at, sensor_m});
        }
        p.planes.push_back(plane);
    }
    return p;
}

Vector6 prior_weights() {
    Vector6 weights;
    weights << 1.0, 1.0, 1.0, 50.0, 50.0, 50.0;
    return weights;
}
/// A prior between two poses, and the twist from the expected to the actual second pose.
const glm::dvec3 kOffset_m(1.0, 0.1, 0.0);
Matrix6 motion_weights() {
    Vector6 a;
    a << 20.0, 3.0, 0.0, 1.0, 0.0, 2.0;
    return a * a.transpose();
}
Vector6 motion_difference() {
    Vector6 d;
    d << 0.02, -0.01, 0.03, 0.002, 0.001, -0.003;
    return d;
}

/// Solves min sum w (r + row of poses . x - row of plane . y)^2 + priors over x and y by
/// dense elimination of the planes. The remaining equations for the poses are H x = -g.
struct DenseEquations {
    Eigen::MatrixXd h;
    Eigen::VectorXd g;
};

DenseEquations make_dense_equations(const Problem& problem) {
    const Eigen::Index n = 6 * (kPoses + 1), m = n + 3 * Eigen::Index(problem.planes.size());
    Eigen::MatrixXd h = Eigen::MatrixXd::Zero(m, m);
    Eigen::VectorXd g = Eigen::VectorXd::Zero(m);
    for (std::size_t c = 0; c < problem.planes.size(); ++c)
        for (const std::uint32_t i : problem.members[c]) {
            const PlaneResidual row = make_residual(problem.placed[i], problem.planes[c], problem.scale_m);
            const SubsampledPoint& point = problem.points[i];
            const glm::dvec3 d = problem.placed[i].point_m - problem.planes[c].point_m;
            Eigen::VectorXd all = Eigen::VectorXd::Zero(m);
            all.segment<6>(6 * Eigen::Index(point.left)) += (1.0 - double(point.s)) * row.j;
            all.segment<6>(6 * Eigen::Index(point.left + 1)) += double(point.s) * row.j;
            all.segment<3>(n + 3 * Eigen::Index(c)) -=
                Eigen::Vector3d(1.0, glm::dot(problem.planes[c].u, d), glm::dot(problem.planes[c].v, d));
            h += row.weight * all * all.transpose();
            g += row.weight * row.residual_m * all;
        }
    for (Eigen::Index k = 0; k <= kPoses; ++k)
        h.block<6, 6>(6 * k, 6 * k) += Matrix6(prior_weights().asDiagonal());
    for (Eigen::Index k = 0; k < kPoses; ++k) {
        // The next pose is expected to move by (v + w x offset, w) of the pose.
        Eigen::MatrixXd row = Eigen::MatrixXd::Zero(6, m);
        row.block<6, 6>(0, 6 * k + 6).setIdentity();
        row.block<6, 6>(0, 6 * k).diagonal().setConstant(-1.0);
        for (int axis = 0; axis < 3; ++axis) {
            glm::dvec3 w(0.0);
            w[axis] = 1.0;
            const glm::dvec3 moved = glm::cross(w, kOffset_m);
            for (int i = 0; i < 3; ++i) row(i, 6 * k + 3 + axis) = -moved[i];
        }
        h += row.transpose() * motion_weights() * row;
        g += row.transpose() * motion_weights() * motion_difference();
    }
    const Eigen::LLT<Eigen::MatrixXd> planes(h.bottomRightCorner(m - n, m - n));
    const Eigen::MatrixXd coupling = h.topRightCorner(n, m - n);
    return {h.topLeftCorner(n, n) - coupling * planes.solve(coupling.transpose()),
            g.head(n) - coupling * planes.solve(g.tail(m - n))};
}

/// Compares the cost after the step instead of the step, because points hardly determine
/// some directions of the step.
TEST(PoseEquations, StepIsThatOfTheWholeProblem) {
    for (const unsigned seed : {1u, 2u, 3u, 4u, 5u}) {
        const Problem p = make_random_problem(seed);
        PoseEquations equations(kPoses + 1);
        for (std::size_t c = 0; c < p.planes.size(); ++c)
            equations.add_cell(p.points, p.placed, p.members[c], p.planes[c], p.scale_m);
        for (std::size_t k = 0; k <= kPoses; ++k) {
            equations.add_zero_prior(k, prior_weights(), Vector6::Zero());
            if (k < kPoses) equations.add_motion_prior(k, motion_weights(), kOffset_m, motion_difference());
        }
        const Eigen::VectorXd actual = equations.solve_steps(p.track);
        const DenseEquations dense = make_dense_equations(p);
        const Eigen::VectorXd expected = -dense.h.ldlt().solve(dense.g), off = actual - expected;
        EXPECT_LT(off.dot(dense.h * off), 1e-4 * expected.dot(dense.h * expected)) << "seed " << seed;
    }
}

}  // namespace
}  // namespace relidar
