// SPDX-License-Identifier: Apache-2.0
// Replaces pcap_file.cpp if libpcap is missing or RELIDAR_PCAP is off.

#include "base/fail.hpp"
#include "read/bag/bag_file.hpp"

namespace relidar::bag {

std::unique_ptr<BagFile> open_pcap_file(const std::filesystem::path&, const std::filesystem::path& name) {
    fail<UsageError>(
        "{}: found a capture of packets, but this relidar was built without the reader of captures; install "
        "libpcap-dev, and build relidar again with RELIDAR_PCAP=ON",
        name.string());
}

}  // namespace relidar::bag
