// SPDX-License-Identifier: Apache-2.0
// Interface of the packet decoders of spinning LiDARs. Packets contain every firing, so
// the rays without a return (dropped rays) are known. products.cpp lists the supported
// products. block_decoder.cpp decodes Velodyne and Hesai. ouster_decoder.cpp decodes
// Ouster.
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

/// The bytes of a packet as they were received, with the receive time.
struct PacketView {
    std::int64_t stamp_ns = 0;
    std::string_view bytes;
};

/// One return of a ray: range and intensity.
struct Echo {
    float range_m = 0.0f;    ///< distance from the origin of the beam; 0 means no return
    float intensity = 0.0f;  ///< intensity from 0 to 1
};

/// One firing of all beams.
struct Firing {
    /// index of the firing in the packet; firings that were not measured also have an
    /// index
    int slot = 0;
    double after_us = 0.0;  ///< time from the packet's time to the first beam of the firing
    /// Azimuth of the head when the first beam of the firing fires. It is clockwise from
    /// the sensor's x axis, in [0, 360).
    double azimuth_deg = 0.0;
    /// index of the firing sequence, if the sensor alternates between sequences
    /// (Timing::parts)
    int part = 0;
};

struct Packet {
    /// Time of the packet by the sensor's clock. The clock restarts at 0 after
    /// Timing::wrap_us.
    std::int64_t clock_ns = 0;
    int n_slots = 0;  ///< firings per packet
    std::vector<Firing> firings;
    /// [firings x rings] first and second return of each ray, in the order of the packet
    std::vector<std::array<Echo, 2>> echoes;
};

/// Firing times of the lasers of a sensor.
struct Timing {
    double cycle_us = 0.0;  ///< time between firings
    /// Number of firing sequences between which the sensor alternates. Each sequence has
    /// separate beams. One column of the scan contains one firing of each sequence.
    int parts = 1;
    /// time after which the sensor's clock restarts at 0; 0 means that it never restarts
    double wrap_us = 0.0;
    /// [rings] time of each beam after the start of the firing. With several firing
    /// sequences, time after the start of the first sequence.
    std::vector<double> offset_us;
    /// True if the head angle of a beam is interpolated between the azimuths of two
    /// neighbouring firings. If false, the head is assumed to rotate at a constant rate.
    bool interpolates = false;
    /// [columns per revolution] true if the sensor fires at this column. Column 0 is at
    /// 180 degrees. Empty if the sensor fires at any azimuth. If the list is not empty,
    /// the sensor's clock defines all times. If it is empty, the time stamps of the
    /// packets define them.
    std::vector<bool> fires = {};
    /// True if intensities can exceed 1. The intensity that is scaled to 1 is then
    /// estimated from all intensities of the topic.
    bool is_wide = false;
};

class Decoder {
public:
    virtual ~Decoder() = default;
    /// Decodes a packet of the product that this decoder supports.
    /// @throws DataError if the packet is invalid
    virtual Packet decode(std::string_view bytes) const = 0;
    virtual const Timing& timing() const = 0;
    /// Returns the model of the spinning sensor. The beams are sorted from the highest to
    /// the lowest.
    /// @param columns  columns per revolution
    virtual SpinningSensor sensor(int columns, double rate_hz) const = 0;
    /// Returns a text with the product and the source of the beam angles.
    virtual std::string about() const = 0;
};

struct OusterFormat;

/// Calibration data that the packets of a sensor do not contain.
struct Calibration {
    std::vector<Correction> corrections = {};  ///< angle corrections of Hesai's sensors
    /// Packet format from the metadata of an Ouster sensor. Null if the sensor is not an
    /// Ouster or its metadata is missing.
    std::shared_ptr<const OusterFormat> ouster = {};
    /// True if the packets of an RS-LiDAR-16 contain two returns. See
    /// have_two_returns().
    bool has_two_returns = false;
};

/// A LiDAR product whose packets relidar recognises.
struct Product {
    const char* name;
    /// Returns true if a packet has the size and the header of this product. The pointer
    /// is null for Ouster, because Ouster packets do not contain the product.
    bool (*is)(std::string_view bytes);
    /// Creates a decoder. The pointer is null if relidar cannot decode packets of this
    /// product.
    /// @throws DataError if a calibration is damaged or belongs to another sensor
    std::unique_ptr<Decoder> (*make)(const char* name, const Calibration& calibration);
    /// name of the driver that can convert the packets; used if relidar has no decoder
    const char* driver = "";
};
/// Finds the product that sent a packet, by the size and the header of the packet. An
/// Ouster packet is recognised by the packet size in the metadata.
/// @return null if no product matches
const Product* find_product(std::string_view bytes, const Calibration& calibration);
/// Returns an error message about a packet that relidar cannot decode, for example
/// "packets of a VLS-128, expected those of ...".
std::string describe_unknown_packet(const Product* product, std::string_view bytes);

/// Returns true if consecutive packets of an RS-LiDAR-16 contain two returns per firing.
/// The packets do not state this. With two returns, a packet contains half as many
/// firings, so the time between packets is half as long.
bool have_two_returns(const std::vector<PacketView>& packets);

/// Creates a decoder for a product: the first function for Velodyne and Hesai, the second
/// for Ouster.
std::unique_ptr<Decoder> make_block_decoder(const char* name, const Calibration& calibration);
std::unique_ptr<Decoder> make_ouster_decoder(const char* name, const Calibration& calibration);

}  // namespace relidar::packets
