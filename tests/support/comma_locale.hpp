// SPDX-License-Identifier: Apache-2.0
// Sets a locale that writes 1234.5 as "1.234,5" while the object exists. The locale
// applies to C++ streams. If the system has such a locale, it also applies to printf and
// strtod. Files that relidar reads and writes must not depend on the locale.
#pragma once

#include <clocale>
#include <locale>
#include <string>

namespace relidar::test {

class CommaLocale {
public:
    CommaLocale()
        : c_before_(std::setlocale(LC_ALL, nullptr)),
          cpp_before_(std::locale::global(std::locale(std::locale::classic(), new Comma))) {
        for (const char* name : {"de_DE.UTF-8", "de_DE.utf8", "fr_FR.UTF-8", "nl_NL.UTF-8", "es_ES.UTF-8",
                                 "it_IT.UTF-8", "pl_PL.UTF-8"})
            if (std::setlocale(LC_ALL, name)) break;
    }
    ~CommaLocale() {
        std::locale::global(cpp_before_);
        std::setlocale(LC_ALL, c_before_.c_str());
    }
    CommaLocale(const CommaLocale&) = delete;
    CommaLocale& operator=(const CommaLocale&) = delete;

private:
    struct Comma : std::numpunct<char> {
        char do_decimal_point() const override { return ','; }
        char do_thousands_sep() const override { return '.'; }
        std::string do_grouping() const override { return "\3"; }
    };
    std::string c_before_;
    std::locale cpp_before_;
};

}  // namespace relidar::test
