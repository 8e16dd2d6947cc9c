// SPDX-License-Identifier: Apache-2.0
// A device that several Python objects and threads share. One thread at a time uses the
// device. The device is closed when no object uses it any more.
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

/// An open device with its lock and the id of the thread that uses the device.
struct OpenDevice {
    Device device;
    std::mutex in_use;
    std::atomic<std::thread::id> user{};  ///< Thread that currently uses the device.

    explicit OpenDevice(const DeviceOptions& options) : device(options) {}
};
using SharedDevice = std::shared_ptr<OpenDevice>;

/// Returns the given device. If it is null, returns the default device and opens it if
/// necessary.
/// @throws DeviceError if the device cannot be opened
SharedDevice device_or_default(SharedDevice device);

/// Locks a device for the current thread. Releases the Python interpreter lock (GIL) at
/// the same time. No Python object may be used while this object exists.
class DeviceUse {
public:
    /// Waits until no other thread uses the device.
    /// @throws UsageError if this thread already uses the device. This happens if a
    /// callback calls a function of the same device.
    explicit DeviceUse(OpenDevice& device);
    ~DeviceUse();
    DeviceUse(const DeviceUse&) = delete;
    DeviceUse& operator=(const DeviceUse&) = delete;

private:
    OpenDevice& device_;
    /// Must be the first member. The interpreter lock is then released before the thread
    /// waits for the device.
    py::gil_scoped_release others_run_;
    std::unique_lock<std::mutex> lock_;
};

/// An object that was created on a device. It keeps the device open. It locks the device
/// while the object is destroyed.
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
            // This thread already uses the device: a training callback destroys a
            // renderer. The device is idle then.
            return;
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
