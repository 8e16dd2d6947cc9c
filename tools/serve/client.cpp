// SPDX-License-Identifier: Apache-2.0
#include "client.hpp"

#include <grpcpp/create_channel.h>
#include <grpcpp/security/credentials.h>
#include <grpcpp/support/channel_arguments.h>

#include "base/fail.hpp"

namespace relidar::serve {

std::shared_ptr<grpc::Channel> open_channel(const std::string& address) {
    grpc::ChannelArguments arguments;
    arguments.SetMaxReceiveMessageSize(-1);
    // Its own connection, so that channels behave like separate client processes.
    arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    return grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), arguments);
}

ScanClient::ScanClient(std::string address)
    : address_(std::move(address)), stub_(v1::RenderService::NewStub(open_channel(address_))) {}

void ScanClient::check_status(const grpc::Status& status) const {
    if (status.ok()) return;
    fail("the service at {} returned status {}: {}", address_, int(status.error_code()),
         status.error_message());
}

v1::ListScenesResponse ScanClient::list_scenes() {
    grpc::ClientContext context;
    v1::ListScenesResponse answer;
    check_status(stub_->ListScenes(&context, {}, &answer));
    return answer;
}

v1::GetTracksResponse ScanClient::tracks(const v1::GetTracksRequest& request) {
    grpc::ClientContext context;
    v1::GetTracksResponse answer;
    check_status(stub_->GetTracks(&context, request, &answer));
    return answer;
}

v1::LidarScan ScanClient::render_scan(const v1::RenderLidarRequest& request) {
    grpc::ClientContext context;
    v1::LidarScan answer;
    check_status(stub_->RenderLidar(&context, request, &answer));
    return answer;
}

}  // namespace relidar::serve
