// SPDX-License-Identifier: Apache-2.0
// One device a test process, with validation as the environment says, opened for the
// traversal that RELIDAR_TEST_TRAVERSAL names (ray_query or software; ctest runs the
// suites that trace once with each), else the one a user would get. No device is a skip
// for a user and a failure where RELIDAR_REQUIRE_GPU=1 (CI). Any validation message fails
// the test in which it appears.
#pragma once

#include <gtest/gtest.h>

#include <relidar/gpu/device.hpp>

namespace relidar::test {

/// The device of this process, or null where there is none.
Device* find_device();

/// Fixture of every test that runs kernels.
class DeviceTest : public ::testing::Test {
protected:
    void SetUp() override;
    void TearDown() override;
    Device& device() { return *device_; }

private:
    Device* device_ = nullptr;
    std::size_t messages_before_ = 0;
};

}  // namespace relidar::test
