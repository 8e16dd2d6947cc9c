// SPDX-License-Identifier: Apache-2.0
// The other end of the line: what tests and `relidar-dev bench --serve` call a service
// with.
#pragma once

#include <memory>
#include <string>

#include <grpcpp/channel.h>

#include "relidar/v1/render.grpc.pb.h"

namespace relidar::serve {

/// A channel of its own, without TLS, that takes scans of any size.
std::shared_ptr<grpc::Channel> connect(const std::string& address);

/// Calls that wait for their answer. @throws DataError with code and message of a status
/// that is not OK
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
