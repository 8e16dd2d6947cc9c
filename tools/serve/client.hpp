// SPDX-License-Identifier: Apache-2.0
// gRPC client for tests and `relidar-dev bench --serve`.
#pragma once

#include <memory>
#include <string>

#include <grpcpp/channel.h>

#include "relidar/v1/render.grpc.pb.h"

namespace relidar::serve {

/// Without TLS and without a limit of message sizes, because scans can be large.
std::shared_ptr<grpc::Channel> open_channel(const std::string& address);

class ScanClient {
public:
    explicit ScanClient(std::string address);

    v1::ListScenesResponse list_scenes();
    v1::GetTracksResponse tracks(const v1::GetTracksRequest& request);
    v1::LidarScan render_scan(const v1::RenderLidarRequest& request);

private:
    std::string address_;
    std::unique_ptr<v1::RenderService::Stub> stub_;

    void check_status(const grpc::Status& status) const;
};

}  // namespace relidar::serve
