// SPDX-License-Identifier: Apache-2.0
// Appends the bytes of values to a string, in the byte order of this machine.
#pragma once

#include <string>

namespace relidar {

template <class T>
void append_raw(std::string& bytes, T value) {
    bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}

}  // namespace relidar
