// SPDX-License-Identifier: Apache-2.0
// Provides one Vulkan device per test process, with validation if the environment enables
// it. RELIDAR_TEST_TRAVERSAL (ray_query or software) selects the traversal backend;
// otherwise the device uses the default backend. A missing GPU skips a test, or fails it
// if RELIDAR_REQUIRE_GPU=1 (CI). A validation message fails the test in which it appears.
#pragma once

#include <gtest/gtest.h>

#include <relidar/gpu/device.hpp>

namespace relidar::test {

/// Returns the device of this process, or null if the machine has no suitable GPU.
Device* find_device();

/// Fixture of every test that runs kernels on the device.
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
