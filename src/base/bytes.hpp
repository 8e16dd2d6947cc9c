// SPDX-License-Identifier: Apache-2.0
// Appends the bytes of values to a string, in the byte order of this machine. Shares
// bytes, for example of a file, without a copy.
#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>

namespace relidar {

template <class T>
void append_raw(std::string& bytes, T value) {
    bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}

struct SharedBytes {
    std::shared_ptr<const void> memory;
    std::string_view bytes;

    SharedBytes share_part(std::string_view subview) const { return {memory, subview}; }
};

inline SharedBytes share_bytes(std::string bytes) {
    const auto memory = std::make_shared<const std::string>(std::move(bytes));
    return {memory, *memory};
}

/// Calls write_bytes(std::span<char>) to write the uninitialised bytes.
template <class Fill>
SharedBytes allocate_bytes(std::size_t n_bytes, const Fill& write_bytes) {
    const std::shared_ptr<char[]> memory(new char[n_bytes]);
    write_bytes(std::span<char>(memory.get(), n_bytes));
    return {memory, {memory.get(), n_bytes}};
}

}  // namespace relidar
