// SPDX-License-Identifier: Apache-2.0
// Replaces pcap_file.cpp if libpcap is missing or RELIDAR_PCAP is off.
#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "log/readers/bag/bag_file.hpp"

namespace relidar::bag {

std::unique_ptr<BagFile> open_pcap(const std::filesystem::path& file) {
    throw UsageError(
        fmt::format("{}: found a capture of packets, expected another dataset: this relidar was built "
                    "without the reader of "
                    "captures (RELIDAR_PCAP, libpcap-dev)",
                    file.string()));
}

}  // namespace relidar::bag
