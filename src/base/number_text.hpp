// SPDX-License-Identifier: Apache-2.0
// Numbers as files hold them: the same text on every machine, whatever its locale and the
// versions of its libraries.
#pragma once

#include <string>

namespace relidar {

/// Shortest decimal text that reads back to the same number. It has a point or an
/// exponent, so that TOML and JSON take it for a real number: "8.0", "1e-09", "-0.0".
/// What is not finite is written as TOML has it, "nan", "inf" or "-inf"; JSON has no such
/// numbers.
std::string number_text(double value);
std::string number_text(float value);  ///< fewer digits: reads back to the same float

}  // namespace relidar
