// SPDX-License-Identifier: Apache-2.0
// A device that several Python objects and threads share: it closes after the last of
// them, and serves one thread at a time.
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

/// An open device and who uses it.
struct OpenDevice {
    Device device;
    std::mutex in_use;
    std::atomic<std::thread::id> user{};  ///< the thread that uses it now

    explicit OpenDevice(const DeviceOptions& options) : device(options) {}
};
using SharedDevice = std::shared_ptr<OpenDevice>;

/// The given device; the default one, which is opened on first use, for null. @throws
/// DeviceError as Device
SharedDevice device_or_default(SharedDevice device);

/// While this lives, its thread alone uses a device, and other threads run Python.
/// Nothing of Python may be touched meanwhile.
class DeviceUse {
public:
    /// @throws UsageError where this thread uses the device already: a callback calls
    /// what it was called from
    explicit DeviceUse(OpenDevice& device);
    ~DeviceUse();
    DeviceUse(const DeviceUse&) = delete;
    DeviceUse& operator=(const DeviceUse&) = delete;

private:
    OpenDevice& device_;
    py::gil_scoped_release others_run_;  ///< first: who waits for a device must not hold the interpreter
    std::unique_lock<std::mutex> lock_;
};

/// Something made on a device, which is kept open for it and is free when it goes.
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
            return;  // a callback of a training drops a renderer: nothing runs just now
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
