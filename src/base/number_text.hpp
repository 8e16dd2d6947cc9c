// SPDX-License-Identifier: Apache-2.0
// Converts numbers to text for files. The text does not depend on the machine, the locale
// or the versions of libraries.
#pragma once

#include <string>

namespace relidar {

/// Returns the shortest decimal text that reads back to the same number. The text has a
/// point or an exponent, so that TOML and JSON read it as a real number: "8.0", "1e-09",
/// "-0.0". Values that are not finite become "nan", "inf" or "-inf", as in TOML. JSON has
/// no such numbers.
std::string number_text(double value);
/// Returns the shortest decimal text that reads back to the same float. It has fewer
/// digits than the text of a double.
std::string number_text(float value);

}  // namespace relidar
