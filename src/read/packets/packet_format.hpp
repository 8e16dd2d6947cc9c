// SPDX-License-Identifier: Apache-2.0
// Interface of the packet formats: block_formats.cpp (Velodyne and Hesai) and
// ouster_format.cpp. packet_encoder.cpp distributes the firings of scans to packets.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include <relidar/read/packets.hpp>

#include "read/packets/decoder.hpp"

namespace relidar::packets {

/// All lasers of a rotating LiDAR at one azimuth of its head, with their returns.
struct FiringColumn {
    double time_s = 0.0;       ///< time of the first laser, in the time of the log
    double clock_s = 0.0;      ///< the same by the clock of the sensor
    double azimuth_deg = 0.0;  ///< azimuth of the head, clockwise from the x axis, 0 to 360
    bool is_measured = false;  ///< false if the scans do not contain this firing
    bool is_filled = false;    ///< time and azimuth are interpolated
    bool has_returns = false;
    /// [rings] strongest and second strongest return of each beam, highest beam first;
    /// empty if no scan contains the firing
    std::vector<std::array<DecodedReturn, 2>> returns = {};

    bool is_known() const { return is_measured || is_filled; }
};

/// Returns the firings of a scan, sorted by time. A firing contains the rays of all
/// lasers at one azimuth.
/// @param beam_delays_us  [rings] delay of each beam after the first laser of the firing
/// @throws UsageError if the scan is not in image order or has no firing times
std::vector<FiringColumn> extract_firings(const Scan& scan, double scan_time_s, const SpinningSensor& sensor,
                                          const std::vector<double>& beam_delays_us);

class PacketFormat {
public:
    virtual ~PacketFormat() = default;
    virtual int udp_port() const = 0;
    virtual int firings_per_packet() const = 0;
    /// Returns the time between two firings in microseconds.
    virtual double firing_period_us() const = 0;
    /// Returns the number of packets of a firing. It is above 1 if the lasers fire in
    /// several sequences and each sequence has a packet.
    virtual int packets_per_firing() const { return 1; }
    /// Returns the number of scan columns of a firing (all lasers at one azimuth): 2 if
    /// the lasers fire in two sequences and the scan stores each as a column, otherwise
    /// 1.
    virtual int columns_per_firing() const { return 1; }
    /// Converts scan columns to firings. Joins the two columns of a firing and removes
    /// simulated rays of lasers that do not fire in the sequence of their column.
    virtual std::vector<FiringColumn> merge_columns(std::vector<FiringColumn> scan_columns) const {
        return scan_columns;
    }
    /// Number of azimuths per turn at which the sensor fires, column 0 at its back; 0 if
    /// it can fire at any azimuth.
    virtual int fixed_columns() const { return 0; }
    /// Returns for each ring the delay of its beam in microseconds after the first laser
    /// of a column.
    virtual std::vector<double> beam_delays() const = 0;
    /// Returns the calibration file that other programs need to decode the packets.
    /// @param fired  [columns] true if the sensor fires at this column; empty
    /// if the sensor fires at any azimuth
    virtual PacketCalibrationFile make_calibration([[maybe_unused]] const std::vector<bool>& fired) const {
        return {};
    }
    /// Encodes one packet. Its bytes contain the time on the sensor's clock.
    /// @param number  sequence number of the packet, from 0
    virtual SensorPacket encode_packet(std::span<const FiringColumn> firings, std::uint32_t number) const = 0;
};

// Create the packet format of a manufacturer, or return null if the sensor is from
// another manufacturer.
std::unique_ptr<PacketFormat> make_velodyne(const SpinningSensor& sensor, const PacketOptions& options);
std::unique_ptr<PacketFormat> make_hesai(const SpinningSensor& sensor, const PacketOptions& options);
std::unique_ptr<PacketFormat> make_ouster(const SpinningSensor& sensor, const PacketOptions& options);

/// A sensor whose packets consist of blocks.
struct BlockSensor {
    std::string name, maker;
};
std::vector<BlockSensor> block_sensors();

/// @return nanoseconds since 1970
std::int64_t to_unix_ns(double log_time_s, std::int64_t log_start_unix_ns);
/// Converts the intensity of a return (0 to 1) to a one-byte reflectivity.
std::uint8_t to_reflectivity(const DecodedReturn& laser_return);

}  // namespace relidar::packets
