// SPDX-License-Identifier: Apache-2.0
#include "conversions.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include "base/fail.hpp"

#include "module.hpp"

namespace relidar::python {
namespace {

// Maximum difference between R^T R and the identity matrix, for a rotation R. A smaller
// limit would reject rotations from text files with six digits.
constexpr double kMaxRotationError = 1e-4;

/// Converts a 4x4 matrix of row-major numbers to a pose. Rejects every matrix that is not
/// a rotation and a translation.
Pose read_pose(const double* matrix, const std::string& where) {
    const auto fail = [&](const std::string& found) {
        throw DataError(fmt::format(
            "{}: found {}, expected a rigid pose: a rotation and a translation, with the last row 0 0 0 1",
            where, found));
    };
    if (!std::all_of(matrix, matrix + 16, [](double value) { return std::isfinite(value); }))
        fail("a matrix with a number that is not finite");
    if (matrix[12] != 0.0 || matrix[13] != 0.0 || matrix[14] != 0.0 || matrix[15] != 1.0)
        fail(fmt::format("a matrix with the last row {} {} {} {}", matrix[12], matrix[13], matrix[14],
                         matrix[15]));
    // GLM expects the columns of a matrix, so the numbers are reordered.
    const glm::dmat3 rotation(matrix[0], matrix[4], matrix[8], matrix[1], matrix[5], matrix[9], matrix[2],
                              matrix[6], matrix[10]);
    const glm::dmat3 square = glm::transpose(rotation) * rotation;  // identity for a rotation
    double worst = 0.0;                                             // largest difference from the identity
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) worst = std::max(worst, std::abs(square[i][j] - (i == j ? 1.0 : 0.0)));
    if (!(worst <= kMaxRotationError))
        fail(
            fmt::format("a matrix whose upper left 3 x 3 part R is no rotation, because R^T R differs by "
                        "{:.1e} from the identity and at most {:.0e} is allowed",
                        worst, kMaxRotationError));
    if (glm::determinant(rotation) < 0.0) fail("a mirrored matrix");
    return {glm::normalize(glm::quat_cast(rotation)), {matrix[3], matrix[7], matrix[11]}};
}

}  // namespace

Pose to_pose(const py::handle& matrix, const std::string& where) {
    const py::object array = to_numpy(matrix);
    return read_pose(array_values<double>(array, where, {4, 4}).data(), where);
}

std::vector<Pose> to_poses(const py::handle& matrices, const std::string& where) {
    const py::object array = to_numpy(matrices);
    const std::span<const double> numbers = array_values<double>(array, where, {kAnyLength, 4, 4});
    std::vector<Pose> poses;
    for (std::size_t i = 0; i < numbers.size() / 16; ++i)
        poses.push_back(read_pose(numbers.data() + 16 * i, fmt::format("{}[{}]", where, i)));
    return poses;
}

/// Converts a single pose [4,4] or a pair (times [n], poses [n,4,4]) to a track. A single
/// pose gets the time `time_s`.
PoseTrack to_track(const py::handle& object, const std::string& where, double time_s) {
    if (!py::isinstance<py::tuple>(object)) return {.time_s = {time_s}, .pose = {to_pose(object, where)}};
    const auto pair = py::reinterpret_borrow<py::tuple>(object);
    if (pair.size() != 2)
        fail("{}: found a tuple of {} entries, expected a pose [4,4] or (times [n], poses [n,4,4])", where,
             pair.size());
    PoseTrack track{copy_array<double, double>(pair[0], where + ": times", {kAnyLength}),
                    to_poses(pair[1], where + ": poses")};
    if (track.time_s.size() != track.pose.size())
        fail("{}: found {} times and {} poses, expected the same number of both", where, track.time_s.size(),
             track.pose.size());
    return track;
}

void append_pose(std::vector<double>& numbers, const Pose& pose) {
    // GLM stores a matrix by columns, numpy by rows.
    const glm::dmat4 columns = to_matrix(pose);
    for (int row = 0; row < 4; ++row)
        for (int column = 0; column < 4; ++column) numbers.push_back(columns[column][row]);
}

py::array pose_matrix(const Pose& pose) {
    std::vector<double> numbers;
    append_pose(numbers, pose);
    return move_to_numpy<double>(std::move(numbers), {4, 4});
}

py::tuple to_times_and_poses(const PoseTrack& track, const glm::dvec3& position_offset_m) {
    std::vector<double> numbers;
    for (const Pose& pose : shift_track(track, position_offset_m).pose) append_pose(numbers, pose);
    const auto n = static_cast<py::ssize_t>(track.pose.size());
    return py::make_tuple(move_to_numpy<double>(std::vector<double>(track.time_s), {n}),
                          move_to_numpy<double>(std::move(numbers), {n, 4, 4}));
}

/// Adds relidar.pose(), which makes a matrix from a position and angles.
void bind_poses(py::module_& module) {
    module.def(
        "pose",
        [](double x, double y, double z, double yaw_deg, double pitch_deg, double roll_deg) {
            const double radians = kPi / 180.0;
            return pose_matrix(
                {make_rotation(yaw_deg * radians, pitch_deg * radians, roll_deg * radians), {x, y, z}});
        },
        py::arg("x"), py::arg("y"), py::arg("z"), py::arg("yaw_deg") = 0.0, py::arg("pitch_deg") = 0.0,
        py::arg("roll_deg") = 0.0,
        "Returns a pose a_from_b as [4,4] float64: the origin of b is at x, y, z in a, in metres, and its "
        "rotation is Rz(yaw) Ry(pitch) Rx(roll).");
}

}  // namespace relidar::python
