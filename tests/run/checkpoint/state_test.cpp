// SPDX-License-Identifier: Apache-2.0
#include <bit>

#include <relidar/run/checkpoint.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "../../support/device.hpp"
#include "../files/example_run.hpp"
#include "support/names.hpp"
#include "support/same_surfels.hpp"

namespace relidar {
namespace {

class DeviceState : public test::DeviceTest {};

TEST(State, NumbersAndVectorsComeBack) {
    Checkpoint checkpoint;
    CheckpointWriter write(checkpoint);
    const std::uint64_t state = 0x0123456789ABCDEFull;
    write("state", state);
    write("order", std::vector<std::uint64_t>{2, 0, 1});
    write("extent", 0.1);
    write("empty", std::vector<float>{});
    const CheckpointReader read(checkpoint);
    std::uint64_t state_back = 0;
    double extent = 0.0;
    std::vector<std::uint64_t> order;
    std::vector<float> empty(3);
    read("state", state_back);
    read("extent", extent);
    read("order", order);
    read("empty", empty);
    EXPECT_EQ(state_back, state);
    EXPECT_EQ(std::bit_cast<std::uint64_t>(extent), std::bit_cast<std::uint64_t>(0.1));
    EXPECT_EQ(order, (std::vector<std::uint64_t>{2, 0, 1}));
    EXPECT_TRUE(empty.empty());
}

TEST(State, WhatDoesNotFitIsNamed) {
    Checkpoint checkpoint{7, {}, {}};
    CheckpointWriter write(checkpoint);
    write("x", std::vector<float>{1.0f, 2.0f});
    const CheckpointReader read(checkpoint);
    double number = 0.0;
    std::vector<double> wrong_type;
    EXPECT_THAT(get_data_error_message([&] { read("y", number); }),
                test::Names("iteration 7 ... array \"y\""));
    EXPECT_THAT(get_data_error_message([&] { read("x", number); }),
                test::Names("array x ... f4 ... [2] ... f8 ... []"));
    EXPECT_THAT(get_data_error_message([&] { read("x", wrong_type); }),
                test::Names("array x ... f4 ... [2] ... f8 ... [2]"));
    EXPECT_THAT(get_data_error_message([&] { checkpoint.text("layout"); }), test::Names("key \"layout\""));
}

TEST_F(DeviceState, SurfelsAndArraysComeBack) {
    constexpr std::uint32_t n = 5;
    const Surfels surfels = make_example_surfels(n);
    SurfelArrays arrays(device(), n, "state"), back(device(), n, "state read back"),
        smaller(device(), n - 1, "too small");
    arrays.upload(surfels);
    Array<float> statistics(device(), std::vector<float>{3.0f, 1.0f, 4.0f}, "statistics"),
        statistics_back(device(), 3, "statistics read back");
    Checkpoint checkpoint;
    CheckpointWriter write(checkpoint);
    write("parameters", arrays);
    write("statistics", statistics);
    EXPECT_EQ(checkpoint.array("parameters/sh").shape, (std::vector<std::size_t>{n, 3, 16}));
    const CheckpointReader read(checkpoint);
    read("parameters", back);
    read("statistics", statistics_back);
    const Surfels b = back.download(), host = read.read_surfels("parameters");
    for (const Surfels* s : {&b, &host}) test::expect_same_surfels(*s, surfels);
    EXPECT_EQ(statistics_back.download(), statistics.download());
    EXPECT_THAT(get_data_error_message([&] { read("parameters", smaller); }),
                test::Names("array parameters/mean ... f4 ... [5, 3] ... f4 ... [4, 3]"));
    std::erase_if(checkpoint.arrays, [](const NamedArray& a) { return a.name == "parameters/rotation"; });
    EXPECT_THAT(get_data_error_message([&] { read.read_surfels("parameters"); }),
                test::Names("array \"parameters/rotation\""));
}

TEST_F(DeviceState, GaussiansComeBackAndNothingElseInTheirPlace) {
    constexpr std::uint32_t n = 5;
    Surfels gaussians = make_example_surfels(n);
    convert_surfels(gaussians, PrimitiveType::gaussian, 0.3);
    SurfelArrays arrays(device(), n, "state", PrimitiveType::gaussian),
        back(device(), n, "state read back", PrimitiveType::gaussian), of_surfels(device(), n, "surfels");
    arrays.upload(gaussians);
    Checkpoint checkpoint;
    CheckpointWriter{checkpoint}("parameters", arrays);
    const CheckpointReader read(checkpoint);
    read("parameters", back);
    EXPECT_EQ(back.download().log_scale_w, gaussians.log_scale_w);
    EXPECT_EQ(read.read_surfels("parameters").log_scale_w, gaussians.log_scale_w);
    get_data_error_message([&] { read("parameters", of_surfels); });
    EXPECT_EQ(checkpoint.text("parameters/primitive"), "gaussian");
    checkpoint.texts.clear();
    EXPECT_THAT(get_data_error_message([&] { read.read_surfels("parameters"); }),
                test::Names("\"parameters/primitive\""));
    checkpoint.arrays.pop_back();
    checkpoint.texts["parameters/primitive"] = "gaussian";
    EXPECT_THAT(get_data_error_message([&] { read.read_surfels("parameters"); }),
                test::Names("array \"parameters/log_scale_w\""));
    checkpoint.texts["parameters/primitive"] = "cube";
    EXPECT_THAT(get_data_error_message([&] { read.read_surfels("parameters"); }), test::Names("\"cube\""));
}

}  // namespace
}  // namespace relidar
