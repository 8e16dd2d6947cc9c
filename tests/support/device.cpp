// SPDX-License-Identifier: Apache-2.0
// Opens the device of the test process when it is used for the first time.
#include "device.hpp"

#include <cstdlib>
#include <memory>
#include <string>

#include <relidar/base/error.hpp>
#include "gpu/forced.hpp"

namespace relidar::test {

namespace {

RayTracingBackend traversal_from_environment() {
    const char* text = std::getenv("RELIDAR_TEST_TRAVERSAL");
    const std::string name = text ? text : "";
    if (name == "ray_query") return RayTracingBackend::ray_query;
    if (name == "software") return RayTracingBackend::software;
    if (!name.empty())
        throw UsageError("RELIDAR_TEST_TRAVERSAL: found \"" + name + "\", expected ray_query or software");
    return RayTracingBackend::automatic;
}

/// Owns the device of the process. The first test that needs the device opens it. The
/// device is closed after the last test while main() still runs, because the static
/// objects of the validation layer could otherwise be destroyed before the device.
class ProcessDevice : public testing::Environment {
public:
    Device* find() {
        if (!device_ && failure_.empty()) open();
        return device_.get();
    }
    const std::string& failure() const { return failure_; }
    void TearDown() override { device_.reset(); }

private:
    void open() {
        try {
            device_ =
                std::make_unique<Device>(apply_environment({.traversal = traversal_from_environment()}));
        } catch (const Error& error) {
            failure_ = error.what();
        }
    }

    std::unique_ptr<Device> device_;
    std::string failure_;
};

ProcessDevice* const process_device =
    static_cast<ProcessDevice*>(testing::AddGlobalTestEnvironment(new ProcessDevice));

}  // namespace

Device* find_device() { return process_device->find(); }

void DeviceTest::SetUp() {
    device_ = find_device();
    if (device_) {
        messages_before_ = validation_count(*device_);
        return;
    }
    const char* required = std::getenv("RELIDAR_REQUIRE_GPU");
    if (required && std::string(required) == "1")
        FAIL() << "RELIDAR_REQUIRE_GPU=1, but " << process_device->failure();
    GTEST_SKIP() << process_device->failure();
}

void DeviceTest::TearDown() {
    if (!device_) return;
    EXPECT_EQ(validation_count(*device_), messages_before_) << "the validation layer complained (see stderr)";
}

}  // namespace relidar::test
