// SPDX-License-Identifier: Apache-2.0
// Numbers in files, independent of the machine, the locale and library versions.
#pragma once

#include <string>

namespace relidar {

/// Shortest decimal text that converts back to the same number. It has a point or an
/// exponent, so that TOML and JSON read it as a real number: "8.0", "1e-09", "-0.0".
/// Other values become "nan", "inf" or "-inf", which TOML accepts but JSON does not.
std::string number_text(double value);
std::string number_text(float value);

}  // namespace relidar
