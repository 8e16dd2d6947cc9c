// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <string>

namespace relidar {

std::string encode_base64(std::span<const std::uint8_t> bytes);

}  // namespace relidar
