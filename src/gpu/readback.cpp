// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "gpu/stream.hpp"

namespace relidar {

struct ReadbackBuffer::Impl {
    std::string what;
    std::shared_ptr<Buffer::Impl> host;
    std::uint64_t ticket = 0;
    bool pending = false;

    Impl(Device& device, std::size_t n_bytes, const std::string& name)
        : what(name),
          host(std::make_shared<Buffer::Impl>(device.impl(), n_bytes ? n_bytes : 1,
                                              gpu::BufferPurpose::readback, name)) {}
};

ReadbackBuffer::ReadbackBuffer(Device& device, std::size_t n_bytes, const std::string& text)
    : impl_(std::make_unique<Impl>(device, n_bytes, text)) {}
ReadbackBuffer::~ReadbackBuffer() = default;
ReadbackBuffer::ReadbackBuffer(ReadbackBuffer&&) noexcept = default;
ReadbackBuffer& ReadbackBuffer::operator=(ReadbackBuffer&&) noexcept = default;

void ReadbackBuffer::record_copy(Stream& stream, const Buffer& source, std::size_t n_bytes,
                                 std::size_t offset_bytes) {
    Impl& r = *impl_;
    if (n_bytes > r.host->n_bytes || offset_bytes + n_bytes > source.size_bytes())
        throw Error(ExitCode::bug,
                    fmt::format("cannot read back {}: bytes {} to {} of {}, at most {} at once", r.what,
                                offset_bytes, offset_bytes + n_bytes, source.size_bytes(), r.host->n_bytes));
    stream.impl().record_copy(source.impl(), r.host,
                              {.srcOffset = offset_bytes, .dstOffset = 0, .size = n_bytes});
    // Number of the next submission, which executes this copy.
    r.ticket = stream.impl().last_ticket + 1;
    r.pending = true;
}

bool ReadbackBuffer::is_pending() const { return impl_->pending; }

const void* ReadbackBuffer::wait_for_bytes(Stream& stream) {
    Impl& r = *impl_;
    if (r.ticket == 0 || r.ticket > stream.impl().last_ticket)
        throw Error(ExitCode::bug, fmt::format("cannot wait for {}: its copy was not submitted; call "
                                               "record_copy() and submit_commands() first",
                                               r.what));
    stream.wait_for(r.ticket);
    r.pending = false;
    return r.host->mapped;
}

}  // namespace relidar
