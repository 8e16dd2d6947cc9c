// SPDX-License-Identifier: Apache-2.0
// gRPC client for tests and `relidar-dev bench --serve`.
#pragma once

#include <memory>
#include <string>

#include <grpcpp/create_channel.h>
#include <grpcpp/security/credentials.h>
#include <grpcpp/support/channel_arguments.h>

#include "relidar/v1/render.grpc.pb.h"

namespace relidar::serve {

/// Without TLS and without a limit of message sizes, because scans can be large. Each
/// channel has its own connection, so that channels behave like separate processes.
inline std::shared_ptr<grpc::Channel> open_channel(const std::string& address) {
    grpc::ChannelArguments arguments;
    arguments.SetMaxReceiveMessageSize(-1);
    arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    return grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), arguments);
}

template <class Answer>
struct Reply {
    grpc::Status status;
    Answer answer;
};

/// Calls a method of a service, for example RenderService::Stub::RenderLidar.
template <class Stub, class Request, class Answer>
Reply<Answer> call(Stub& stub, grpc::Status (Stub::*method)(grpc::ClientContext*, const Request&, Answer*),
                   const std::type_identity_t<Request>& request) {
    grpc::ClientContext context;
    Reply<Answer> reply;
    reply.status = (stub.*method)(&context, request, &reply.answer);
    return reply;
}

}  // namespace relidar::serve
