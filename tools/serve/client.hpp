// SPDX-License-Identifier: Apache-2.0
// gRPC client of the scan service, used by tests and by `relidar-dev bench --serve`.
#pragma once

#include <memory>
#include <string>

#include <grpcpp/channel.h>

#include "relidar/v1/render.grpc.pb.h"

namespace relidar::serve {

/// Opens a new gRPC channel without TLS. The channel does not limit the size of messages,
/// because scans can be large.
std::shared_ptr<grpc::Channel> connect(const std::string& address);

/// Client that waits for the answer of each call.
/// @throws DataError with the gRPC code and message if a call fails
class ScanClient {
public:
    explicit ScanClient(std::string address);

    v1::ListScenesResponse list_scenes();
    v1::GetTracksResponse get_tracks(const v1::GetTracksRequest& request);
    v1::LidarScan render(const v1::RenderLidarRequest& request);

private:
    std::string address_;
    std::unique_ptr<v1::RenderService::Stub> stub_;

    void check(const grpc::Status& status) const;
};

}  // namespace relidar::serve
