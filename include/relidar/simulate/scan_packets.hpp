// SPDX-License-Identifier: Apache-2.0
// Converts rendered scans to the packets that their sensors send.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include <relidar/read/packets.hpp>
#include <relidar/simulate/scan_files.hpp>

namespace relidar {

/// Converts a rendered scan to a measured scan, for example for a packet encoder. Rays
/// without a return get range 0.
Scan to_measured(const RenderedScan& scan, const Config& config);

/// Converts the scans of a sensor, or of all sensors of a rig, to their network packets.
class ScanPacketEncoder {
public:
    /// @param sensors  output options of each sensor, with its `packets`
    /// @throws UsageError if packets of a sensor cannot be written
    explicit ScanPacketEncoder(std::vector<ScanOutputOptions> sensors);
    ~ScanPacketEncoder();

    /// Adds the scans of a sweep.
    /// @param scans  a scan for each sensor
    /// @return [sensors] packets that are complete
    /// @throws UsageError if a scan does not fit its sensor or overlaps the previous scan
    std::vector<std::vector<SensorPacket>> encode(std::span<const RenderedScan> scans);
    /// Returns the remaining packets. Must be called after the last scans.
    std::vector<std::vector<SensorPacket>> flush();
    const PacketEncoder& encoder(std::size_t sensor) const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
