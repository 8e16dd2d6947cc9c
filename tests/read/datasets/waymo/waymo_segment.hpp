// SPDX-License-Identifier: Apache-2.0
// TOP with 16 x 400 pixels and SIDE_LEFT with 12 x 60, in a box with a parked vehicle.
// The recording vehicle accelerates and turns, and every pixel of TOP has a firing time.
#pragma once

#include "support/logs.hpp"

namespace relidar::test {

/// Encoded fields of a Frame.
struct WaymoFrame {
    std::int64_t timestamp_us = 0;
    std::string context, pose;
    std::vector<std::string> lasers, labels;

    std::string encode_frame_message() const;
};

/// Encodes messages of the public dataset.proto and label.proto.
std::string make_waymo_transform(const glm::dmat4& a_from_b);
std::string make_waymo_calibration(int laser, const std::vector<double>& inclinations, double low,
                                   double high, const glm::dmat4& extrinsic);
std::string make_waymo_context(const std::vector<std::string>& calibrations);
/// Encodes a MatrixFloat, uncompressed or as a zlib stream.
std::string make_waymo_unpacked_matrix(const std::vector<float>& values, const std::vector<int>& dims);
std::string make_waymo_matrix(const std::vector<float>& values, const std::vector<int>& dims);
std::string deflate_bytes(const std::string& bytes);
/// Second returns, poses and labels of pixels may be empty.
std::string make_waymo_laser(int laser, const std::string& first, const std::string& second,
                             const std::string& poses, const std::string& labels = "");
/// Encodes a MatrixInt32 as a zlib stream.
std::string make_waymo_integer_matrix(const std::vector<int>& values, const std::vector<int>& dims);
std::string make_waymo_label(const std::string& id, int type, const glm::dvec3& centre,
                             const glm::dvec3& length_width_height, double heading);

/// Returns a TFRecord: the length, the data, and the masked CRC-32C of both.
std::string make_tfrecord(const std::string& data);

/// Exact content of a pixel.
struct WaymoPixel {
    /// Point in the world frame. For a dropped pixel, the point at 10 m on its ray.
    glm::dvec3 point_m{0.0};
    double time_us = 0.0;
    float range_m = 0.0f;  ///< 0: no return
    float second_m = 0.0f;
    float intensity = 0.0f;  ///< as in Waymo, also above 1
};

struct WaymoSegment : LogFolder {
    static constexpr int kFrames = 3, kTopRows = 16, kTopColumns = 400, kSideRows = 12, kSideColumns = 60;
    static constexpr std::int64_t kStart_us = 1557240134500000, kPeriod_us = 100000;

    std::filesystem::path file;
    std::vector<WaymoFrame> frames;
    std::vector<std::vector<WaymoPixel>> top, side;  ///< [frames][pixels]

    explicit WaymoSegment(const std::string& name);

    void write() const;  ///< writes the current frames

    static glm::dmat4 get_top_extrinsic();
    static std::vector<double> list_top_inclinations();  ///< ascending
    static glm::dmat4 world_from_vehicle(double time_us);
    /// The time is not exactly the middle of the sweep.
    static double label_time_us(int frame);
    static glm::dmat4 get_world_from_parked();  ///< the vehicle "parked", 4.6 x 2 x 1.6 m
};

}  // namespace relidar::test
