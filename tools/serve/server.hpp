// SPDX-License-Identifier: Apache-2.0
// A server of scans: the render thread with its device and scenes, and gRPC. This header
// uses no type of gRPC, because the command line program includes only this header.
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

/// Order in which a pose of SensorsimService transforms a point p of the child frame to
/// the parent frame.
enum class PoseOrder {
    rotation_first,     ///< R p + t. The rotation is applied first, as in the rest of the program.
    translation_first,  ///< R (p + t). The translation is applied first.
};

struct ServerOptions {
    std::vector<std::string> runs;    ///< Runs to serve. Each is written as "RUN" or "NAME=RUN".
    std::vector<std::string> assets;  ///< Asset folders, as written by `relidar assets`.
    /// Channels of scans, which replace the setting render.channels of each run.
    std::optional<std::string> channels;
    Weather weather = {};  ///< Weather of a scan if the request does not set the weather.
    /// Pose order of SensorsimService. No value: that service is not offered.
    std::optional<PoseOrder> sensorsim;
    std::string listen = "127.0.0.1:50051";  ///< Address to listen on. Port 0 selects a free port.
    /// Device memory for all scenes together. 0: half of the device memory.
    std::uint64_t memory_mib = 0;
    std::size_t waiting = 64;  ///< Maximum number of waiting requests, not counting the current one.
    /// PEM files with the TLS certificate and key. If they are empty, TLS is not used.
    std::string tls_cert, tls_key;
    DeviceOptions device;
};

class ScanServer {
public:
    /// Loads all runs, then listens.
    /// @throws UsageError if the address is not available; DataError if a run or key
    /// cannot be read; DeviceError
    explicit ScanServer(const ServerOptions& options);
    /// Ends all calls immediately. Call stop() first to wait for pending calls.
    ~ScanServer();
    ScanServer(const ScanServer&) = delete;
    ScanServer& operator=(const ScanServer&) = delete;

    int port() const;
    const std::string& device_name() const;
    std::vector<std::string> scenes() const;
    /// Returns the driver's error after the device was lost, or no value while it works.
    /// After the loss the health service reports NOT_SERVING, and render calls fail with
    /// UNAVAILABLE.
    std::optional<std::string> device_loss();
    /// Rejects new calls and waits for pending calls.
    /// @param patience longest time to wait; remaining calls are then cancelled
    void stop(std::chrono::milliseconds patience);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar::serve
