// SPDX-License-Identifier: Apache-2.0
// Provides a device per test process. RELIDAR_TEST_TRAVERSAL selects the traversal
// (ray_query or software). Without a device, tests are skipped, or fail if
// RELIDAR_REQUIRE_GPU=1. A validation message fails the test in which it appears.
#pragma once

#include <gtest/gtest.h>

#include <relidar/gpu/device.hpp>

namespace relidar::test {

Device* find_device();

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
