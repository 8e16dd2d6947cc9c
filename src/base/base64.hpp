// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <string>

namespace relidar {

/// Encodes bytes as base64 (RFC 4648, with padding).
std::string encode_base64(std::span<const std::uint8_t> bytes);

}  // namespace relidar
