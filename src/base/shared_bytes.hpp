// SPDX-License-Identifier: Apache-2.0
// Bytes, for example of a file, that several objects share without a copy.
#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>

namespace relidar {

/// Read-only bytes that stay valid as long as any copy of `memory` exists.
struct SharedBytes {
    std::shared_ptr<const void> memory;
    std::string_view bytes;

    /// Returns a view of a part of the bytes. The view keeps the same memory alive.
    SharedBytes with(std::string_view part) const { return {memory, part}; }
};

inline SharedBytes share_bytes(std::string bytes) {
    const auto memory = std::make_shared<const std::string>(std::move(bytes));
    return {memory, *memory};
}

/// Allocates `count` bytes and calls fill(std::span<char>) to write them. The bytes are
/// uninitialised before this call.
template <class Fill>
SharedBytes make_shared_bytes(std::size_t count, const Fill& fill) {
    const std::shared_ptr<char[]> memory(new char[count]);
    fill(std::span<char>(memory.get(), count));
    return {memory, {memory.get(), count}};
}

}  // namespace relidar
