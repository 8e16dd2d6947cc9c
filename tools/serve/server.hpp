// SPDX-License-Identifier: Apache-2.0
// A server of scans that listens: the render thread with its device and scenes, and gRPC
// in front of it. No type of gRPC here: the command line sees this header alone.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <relidar/gpu/device.hpp>
#include <relidar/simulate/weather.hpp>

namespace relidar::serve {

/// How a pose of SensorsimService takes a point p of the child's frame to its parent's.
enum class PoseOrder {
    rotation_first,     ///< R p + t, as everywhere else
    translation_first,  ///< R (p + t)
};

struct ServerOptions {
    std::vector<std::string> runs;           ///< "RUN" or "NAME=RUN"
    std::vector<std::string> assets;         ///< folders of `relidar assets`
    std::optional<std::string> channels;     ///< of scans, in place of each run's own setting render.channels
    Weather weather = {};                    ///< of scans whose request does not say
    std::optional<PoseOrder> sensorsim;      ///< of SensorsimService, which is offered too; none: it is not
    std::string listen = "127.0.0.1:50051";  ///< port 0: a free one
    std::uint64_t memory_mib = 0;   ///< device memory that scenes may hold together; 0: half of the device's
    std::size_t waiting = 64;       ///< requests that may wait, beside the one that is served
    std::string tls_cert, tls_key;  ///< files in PEM; empty: no TLS
    DeviceOptions device;
};

class ScanServer {
public:
    /// Loads all runs, then listens.
    /// @throws UsageError for an address that cannot be listened at, DataError for a run
    /// or key that cannot be read, DeviceError
    explicit ScanServer(const ServerOptions& options);
    /// Stops at once where stop() was not called.
    ~ScanServer();
    ScanServer(const ScanServer&) = delete;
    ScanServer& operator=(const ScanServer&) = delete;

    int port() const;
    const std::string& device_name() const;
    std::vector<std::string> scenes() const;
    /// What the device's driver answered when it lost the device; nothing while it works.
    /// From then on the health service says NOT_SERVING, and calls that render get
    /// UNAVAILABLE.
    std::optional<std::string> device_loss();
    /// No new calls; those there are have so long to end, then they are cancelled.
    void stop(std::chrono::milliseconds patience);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar::serve
