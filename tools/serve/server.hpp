// SPDX-License-Identifier: Apache-2.0
// Server that renders scans for gRPC clients. It consists of the gRPC services and a
// render thread with its device and scenes. This header contains no gRPC types, so that
// files that include it do not need gRPC.
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

/// How a pose (R, t) transforms a point p from child to parent frame.
enum class PoseTransformOrder {
    rotation_first,     ///< R p + t: the rotation is applied first, as everywhere else in relidar.
    translation_first,  ///< R (p + t): the translation is applied first.
};

struct ServerOptions {
    /// "RUN" or "NAME=RUN".
    std::vector<std::string> runs;
    std::vector<std::string> assets;  ///< Asset folders, as written by `relidar assets`.
    std::optional<std::string> channels;
    Weather weather = {};  ///< Weather that is simulated if the request does not contain a weather.
    /// Without a value, SensorsimService is disabled.
    std::optional<PoseTransformOrder> sensorsim;
    std::string listen = "127.0.0.1:50051";  ///< Address to listen on. Port 0 selects a free port.
    /// For all scenes together. 0 means half of the device memory.
    std::uint64_t memory_mib = 0;
    std::size_t waiting = 64;  ///< Maximum number of waiting requests, not counting the current request.
    /// PEM files. If both names are empty, the server does not use TLS.
    std::string tls_cert, tls_key;
    DeviceOptions device;
};

class ScanServer {
public:
    explicit ScanServer(const ServerOptions& options);
    /// Cancels all calls immediately. Call stop_and_wait() first to wait for pending
    /// calls.
    ~ScanServer();

    int port() const;
    const std::string& device_name() const;
    std::vector<std::string> list_scenes() const;
    /// No value as long as the device works. After the loss, the health service reports
    /// NOT_SERVING, and render calls fail with UNAVAILABLE.
    std::optional<std::string> loss_message();
    /// @param max_wait after it, the remaining calls are cancelled
    void stop_and_wait(std::chrono::milliseconds max_wait);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar::serve
