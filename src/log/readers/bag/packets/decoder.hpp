// SPDX-License-Identifier: Apache-2.0
// Interface of the packet decoders of spinning LiDARs. Packets contain every firing, so
// rays without a return (dropped rays) are known. products.cpp lists the products.
// block_decoder.cpp decodes Velodyne and Hesai. ouster_decoder.cpp decodes Ouster.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/log/sensor.hpp>

#include "log/readers/bag/packets/correction.hpp"

namespace relidar::packets {

/// A received packet: its bytes and the time at which it was received.
struct ReceivedPacket {
    std::int64_t stamp_ns = 0;
    std::string_view bytes;
};

/// One return of a ray: range and intensity.
struct DecodedReturn {
    float range_m = 0.0f;    ///< distance from the origin of the beam; 0 means no return
    float intensity = 0.0f;  ///< intensity from 0 to 1
};

/// One firing of all beams.
struct LaserFiring {
    /// index of the firing in the packet; also counts firings that were not measured
    int slot = 0;
    double after_us = 0.0;  ///< time between the packet's time and the first beam of the firing
    /// Azimuth of the head at the start of the firing, clockwise from the sensor's x
    /// axis, in [0, 360).
    double azimuth_deg = 0.0;
    /// index of the firing sequence, for sensors that alternate between several sequences
    int part = 0;
};

struct DecodedPacket {
    /// Time of the packet on the sensor's clock. The clock restarts at 0 after
    /// FiringTiming::wrap_us.
    std::int64_t clock_ns = 0;
    int n_slots = 0;  ///< firings per packet
    std::vector<LaserFiring> firings;
    /// [firings x rings] first and second return of each ray, in the order of the packet
    std::vector<std::array<DecodedReturn, 2>> echoes;
};

/// Firing times of the lasers of a sensor.
struct FiringTiming {
    double cycle_us = 0.0;  ///< time between firings
    /// Number of firing sequences. It is above 1 if the sensor alternates between
    /// sequences in which different lasers fire. A column of a scan contains one firing
    /// of each sequence.
    int parts = 1;
    /// time after which the sensor's clock restarts at 0; 0 if it never restarts
    double wrap_us = 0.0;
    /// [rings] time between the first firing of a column (all lasers at one azimuth) and
    /// the firing of each beam
    std::vector<double> offset_us;
    /// True if the head azimuth of each beam is interpolated between consecutive firings.
    /// False if the rotation rate is assumed to be constant.
    bool interpolates = false;
    /// [columns per revolution] True if the sensor fires at this column. Column 0 is at
    /// 180 degrees. If a sensor has no fixed firing azimuths, this is empty and times are
    /// from the packets' time stamps. Otherwise, times are from the sensor's clock.
    std::vector<bool> fires = {};
    /// True if the packets of this sensor can contain intensities above 1. If they do,
    /// all intensities are divided by the 99.5th percentile of the intensities of the
    /// topic.
    bool is_wide = false;
};

class PacketDecoder {
public:
    virtual ~PacketDecoder() = default;
    /// Decodes a packet of the product that this decoder supports.
    /// @throws DataError if the packet is invalid
    virtual DecodedPacket decode_packet(std::string_view packet_bytes) const = 0;
    virtual const FiringTiming& get_laser_timing() const = 0;
    /// Returns the model of the spinning sensor. The beams are sorted from the highest to
    /// the lowest.
    /// @param columns_per_revolution  columns per revolution
    virtual SpinningSensor make_spinning_sensor_model(int columns_per_revolution,
                                                      double rotation_rate_hz) const = 0;
    /// Returns a text with the name of the product and the source of its beam angles.
    virtual std::string describe_lidar_product() const = 0;
};

struct OusterMetadata;

/// Calibration of a sensor, which its packets do not contain.
struct DecoderCalibration {
    std::vector<AngleCorrection> corrections = {};  ///< angle corrections of Hesai's sensors
    /// Packet format of an Ouster sensor, from its metadata. Null for other sensors, and
    /// if the metadata is missing.
    std::shared_ptr<const OusterMetadata> ouster = {};
    /// For an RS-LiDAR-16: true if each firing in a packet has two returns.
    bool has_two_returns = false;
};

/// A LiDAR product whose packets relidar recognises.
struct LidarProduct {
    const char* name;
    /// Returns true if a packet has the size and the header of this product. The pointer
    /// is null for Ouster, whose packets are recognised by the sensor's metadata.
    bool (*is)(std::string_view bytes);
    /// Creates a decoder. Null if relidar recognises the packets but cannot decode them.
    /// @throws DataError if a calibration is damaged or belongs to another sensor
    std::unique_ptr<PacketDecoder> (*make)(const char* name, const DecoderCalibration& calibration);
    /// driver that the user can use if relidar cannot decode the packets
    const char* driver = "";
};
/// Finds the product that sent a packet by the size and header of the packet. For an
/// Ouster, compares the size with the packet size in its metadata.
/// @return null if no product matches
const LidarProduct* find_product_of_packet(std::string_view packet_bytes,
                                           const DecoderCalibration& calibration);
/// Returns the error message for packets that relidar cannot decode, for example "packets
/// of a VLS-128, expected those of ...".
std::string format_unsupported_packet_error(const LidarProduct* product, std::string_view packet_bytes);

/// Returns true if the packets of an RS-LiDAR-16 contain two returns per firing. The
/// packets do not state this. With two returns, the time between packets is half as long.
bool has_two_returns_per_firing(const std::vector<ReceivedPacket>& packets);

/// Create a packet decoder for the product with this name. The first function is for
/// Velodyne and Hesai, the second for Ouster.
std::unique_ptr<PacketDecoder> make_block_packet_decoder(const char* product_name,
                                                         const DecoderCalibration& calibration);
std::unique_ptr<PacketDecoder> make_ouster_packet_decoder(const char* product_name,
                                                          const DecoderCalibration& calibration);

}  // namespace relidar::packets
