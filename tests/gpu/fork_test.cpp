// SPDX-License-Identifier: Apache-2.0
// A forked process that uses a device of its parent must get an error, and must not hang.
#include <memory>

#include <sys/wait.h>
#include <unistd.h>

#include <relidar/base/error.hpp>
#include <relidar/gpu/stream.hpp>

#include "support/device.hpp"

namespace relidar {
namespace {

class Fork : public test::DeviceTest {};

template <class Call>
bool is_refused(const Call& call) {
    try {
        call();
    } catch (const DeviceError& error) {
        return std::string(error.what()).find("spawn") != std::string::npos;
    }
    return false;
}

TEST_F(Fork, AChildIsRefusedAndCanEnd) {
    auto opened = std::make_unique<Device>(
        apply_environment({.index = device().info().index, .traversal = device().backend()}));
    auto array = std::make_unique<Array<float>>(*opened, std::vector<float>(1000, 1.0f), "values");
    auto stream = std::make_unique<Stream>(*opened);
    stream->fill(array->buffer(), 0);
    stream->submit_and_wait();
    stream->fill(array->buffer(), 1);  // recorded, but not submitted
    const pid_t child = ::fork();
    if (child == 0) {
        ::alarm(30);  // ends a child that hangs
        const bool refused = is_refused([&] { opened->check_process(); }) &&
                             is_refused([&] { array->download(); }) &&
                             is_refused([&] { array->upload(std::vector<float>{1.0f}); }) &&
                             is_refused([&] { stream->submit_and_wait(); }) &&
                             is_refused([&] { Array<float>(*opened, 10, "more values"); });
        stream.reset();
        array.reset();
        opened.reset();
        ::_exit(refused ? 0 : 1);
    }
    int status = -1;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFEXITED(status)) << "the child hangs";
    EXPECT_EQ(WEXITSTATUS(status), 0);
    stream->submit_and_wait();  // the parent continues
}

}  // namespace
}  // namespace relidar
