// SPDX-License-Identifier: Apache-2.0
// Client of a service, for tests and for `relidar-dev bench --serve`.
#pragma once

#include <memory>
#include <string>

#include <grpcpp/channel.h>

#include "relidar/v1/render.grpc.pb.h"

namespace relidar::serve {

/// Opens a separate channel without TLS, with no limit on the size of scans.
std::shared_ptr<grpc::Channel> connect(const std::string& address);

/// Makes synchronous calls.
/// @throws DataError with code and message if a status is not OK
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
