// SPDX-License-Identifier: Apache-2.0
// A device shared by several Python objects and threads. It is closed when its last user
// releases it, and one thread uses it at a time.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <thread>
#include <utility>

#include <pybind11/pybind11.h>

#include <relidar/gpu/device.hpp>

namespace relidar::python {

namespace py = pybind11;

/// An open device, its lock and the thread that uses it.
struct OpenDevice {
    Device device;
    std::mutex in_use;
    std::atomic<std::thread::id> user{};  ///< Thread that currently uses the device.

    explicit OpenDevice(const DeviceOptions& options) : device(options) {}
};
using SharedDevice = std::shared_ptr<OpenDevice>;

/// Returns the given device. For null, returns the default device, which is opened at its
/// first use.
/// @throws DeviceError as Device
SharedDevice device_or_default(SharedDevice device);

/// Reserves a device for the current thread and releases the interpreter lock during its
/// lifetime. Python objects must not be accessed while this object exists.
class DeviceUse {
public:
    /// Waits until the device is free.
    /// @throws UsageError if this thread already uses the device, because a callback
    /// calls a function of the same device
    explicit DeviceUse(OpenDevice& device);
    ~DeviceUse();
    DeviceUse(const DeviceUse&) = delete;
    DeviceUse& operator=(const DeviceUse&) = delete;

private:
    OpenDevice& device_;
    /// Declared first, so that the interpreter lock is released before the thread waits
    /// for the device.
    py::gil_scoped_release others_run_;
    std::unique_lock<std::mutex> lock_;
};

/// An object made on a device. Keeps the device open and reserves it while the object is
/// destroyed.
template <class Made>
class OnDevice {
public:
    OnDevice() = default;
    OnDevice(SharedDevice device, std::unique_ptr<Made> made)
        : device_(std::move(device)), made_(std::move(made)) {}
    OnDevice(OnDevice&&) noexcept = default;
    OnDevice& operator=(OnDevice&& other) noexcept {
        std::swap(device_, other.device_);
        std::swap(made_, other.made_);
        return *this;
    }
    ~OnDevice() {
        if (!made_ || device_->user == std::this_thread::get_id())
            return;  // A training callback destroys a renderer. The device is idle at this point.
        const DeviceUse use(*device_);
        made_.reset();
    }

    Made& operator*() { return *made_; }
    Made* operator->() { return made_.get(); }
    explicit operator bool() const { return made_ != nullptr; }
    OpenDevice& device() { return *device_; }

private:
    SharedDevice device_;
    std::unique_ptr<Made> made_;
};

}  // namespace relidar::python
