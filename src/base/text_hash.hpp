// SPDX-License-Identifier: Apache-2.0
// Hashes texts with FNV-1a (Fowler, Noll, Vo), which is equal on every machine.
#pragma once

#include <array>
#include <cstdint>
#include <string_view>

namespace relidar {

inline std::uint64_t hash_text(std::string_view text, std::uint64_t start = 0xcbf29ce484222325u) {
    std::uint64_t hash = start;
    for (const char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
    return hash;
}

/// Two hashes from different start values, because one is too short for unique names.
inline std::array<std::uint64_t, 2> hash_text_twice(std::string_view text) {
    return {hash_text(text), hash_text(text, 0x84222325cbf29ce4u)};
}

}  // namespace relidar
