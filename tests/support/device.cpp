// SPDX-License-Identifier: Apache-2.0
// The test process's device, opened once.
#include "device.hpp"

#include <cstdlib>
#include <memory>
#include <string>

#include <relidar/error.hpp>

namespace relidar::test {

namespace {

std::string& failure() {
    static std::string text;
    return text;
}

Traversal wanted_traversal() {
    const char* text = std::getenv("RELIDAR_TEST_TRAVERSAL");
    const std::string name = text ? text : "";
    if (name == "ray_query") return Traversal::ray_query;
    if (name == "software") return Traversal::software;
    if (!name.empty()) throw UsageError("RELIDAR_TEST_TRAVERSAL: found \"" + name + "\", expected ray_query or software");
    return Traversal::automatic;
}

}  // namespace

Device* find_device() {
    static const std::unique_ptr<Device> device = [] {
        try {
            return std::make_unique<Device>(DeviceOptions{.traversal = wanted_traversal()});
        } catch (const Error& error) {
            failure() = error.what();
            return std::unique_ptr<Device>();
        }
    }();
    return device.get();
}

void DeviceTest::SetUp() {
    device_ = find_device();
    if (device_) {
        messages_before_ = device_->validation_messages();
        return;
    }
    const char* required = std::getenv("RELIDAR_REQUIRE_GPU");
    if (required && std::string(required) == "1") FAIL() << "RELIDAR_REQUIRE_GPU=1, but " << failure();
    GTEST_SKIP() << failure();
}

void DeviceTest::TearDown() {
    if (device_) EXPECT_EQ(device_->validation_messages(), messages_before_) << "the validation layer complained (see stderr)";
}

}  // namespace relidar::test
