// SPDX-License-Identifier: Apache-2.0
// A GPU that several Python objects and threads share. Only one thread at a time uses it.
// The device is closed when the last object that uses it is destroyed.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <thread>
#include <utility>

#include <pybind11/pybind11.h>

#include <relidar/base/error.hpp>
#include <relidar/gpu/device.hpp>

namespace relidar::python {

namespace py = pybind11;

struct LockableDevice {
    Device device;
    std::mutex in_use;
    std::atomic<std::thread::id> user{};  ///< Thread that currently uses the device.

    explicit LockableDevice(const DeviceOptions& options) : device(options) {}
};
using SharedDevice = std::shared_ptr<LockableDevice>;

/// Returns the given device. If the argument is null, returns the default device, which
/// is opened at the first call.
/// @throws DeviceError if the device cannot be opened
SharedDevice device_or_default(SharedDevice device);

/// Locks a device for the current thread and releases the Python interpreter lock (GIL).
/// The thread must not use Python objects while this object exists.
class DeviceLock {
public:
    /// Waits until no other thread uses the device.
    /// @throws UsageError if this thread already uses the device, for example because a
    /// callback calls a function of the same device
    /// @throws DeviceError in a process that was forked after the device was opened
    explicit DeviceLock(LockableDevice& device);
    ~DeviceLock();
    DeviceLock(const DeviceLock&) = delete;
    DeviceLock& operator=(const DeviceLock&) = delete;

private:
    LockableDevice& device_;
    /// Releases Python's global lock (GIL). Declared before `lock_`, so that no thread
    /// holds the GIL while it waits for the device.
    py::gil_scoped_release gil_released_;
    std::unique_lock<std::mutex> lock_;
};

/// An object that was created on a device. It keeps the device open, and locks the device
/// while the object is destroyed.
template <class Made>
class DeviceObject {
public:
    DeviceObject() = default;
    /// Creates an object on a device, which is locked meanwhile.
    template <class... Arguments>
    static DeviceObject create(SharedDevice device, const Arguments&... arguments) {
        DeviceObject object;
        const DeviceLock lock(*device);
        object.made_ = std::make_unique<Made>(device->device, arguments...);
        object.device_ = std::move(device);
        return object;
    }
    DeviceObject(DeviceObject&&) noexcept = default;
    DeviceObject& operator=(DeviceObject&& other) noexcept {
        std::swap(device_, other.device_);
        std::swap(made_, other.made_);
        return *this;
    }
    ~DeviceObject() {
        if (!made_ || device_->user == std::this_thread::get_id())
            // In a training callback, this thread has already locked the device, and the
            // device is idle. Locking it again would be an error.
            return;
        try {
            const DeviceLock use(*device_);
            made_.reset();
        } catch (const DeviceError&) {
            // A forked process cannot use the device. Its destructors do nothing.
        }
    }

    /// Calls a function with the object while the device is locked.
    template <class Call>
    auto use(const Call& call) {
        const DeviceLock lock(*device_);
        return call(*made_);
    }
    Made* operator->() { return made_.get(); }
    explicit operator bool() const { return made_ != nullptr; }
    const SharedDevice& device() const { return device_; }

private:
    SharedDevice device_;
    std::unique_ptr<Made> made_;
};

}  // namespace relidar::python
