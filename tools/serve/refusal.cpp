// SPDX-License-Identifier: Apache-2.0
#include "refusal.hpp"

#include <new>

#include <relidar/error.hpp>

namespace relidar::serve {

grpc::Status answered(const std::function<void()>& answer) {
    try {
        answer();
        return grpc::Status::OK;
    } catch (const Refusal& refusal) {
        return {refusal.code(), refusal.what()};
    } catch (const UsageError& error) {
        return {grpc::StatusCode::INVALID_ARGUMENT, error.what()};
    } catch (const std::bad_alloc&) {
        return {grpc::StatusCode::RESOURCE_EXHAUSTED, "answering a request: the server is out of memory, expected a smaller one"};
    } catch (const std::exception& error) {   // of the device, of a run folder that has changed, of ourselves
        return {grpc::StatusCode::INTERNAL, error.what()};
    }
}

}  // namespace relidar::serve
