// SPDX-License-Identifier: Apache-2.0
// Decoders for packets of spinning LiDARs, one per product behind a common interface.
// Packets contain every firing, so dropped rays are known. products.cpp has the list of
// products. block_decoder.cpp decodes Velodyne and Hesai, ouster_decoder.cpp decodes
// Ouster.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar::packets {

/// A packet as it was received.
struct PacketView {
    std::int64_t stamp_ns = 0;
    std::string_view bytes;
};

/// Measurement of a beam.
struct Echo {
    float range_m = 0.0f;    ///< relative to the beam's origin; 0: no return
    float intensity = 0.0f;  ///< intensity from 0 to 1
};

/// One firing of all beams.
struct Firing {
    int slot = 0;           ///< position in the packet; firings that did not happen are omitted
    double after_us = 0.0;  ///< time of the first beam, relative to the packet's time
    /// Azimuth of the head at the first beam, clockwise from the sensor's x axis, in [0,
    /// 360).
    double azimuth_deg = 0.0;
};

struct Packet {
    std::int64_t clock_ns = 0;  ///< time of the packet on the sensor's clock; wraps after Timing::wrap_us
    int n_slots = 0;            ///< firings per packet
    std::vector<Firing> firings;
    /// [firings x rings] returns of each ray in the packet's order
    std::vector<std::array<Echo, 2>> echoes;
};

/// Constants of the packets of a sensor.
struct Timing {
    double cycle_us = 0.0;          ///< time between firings
    double wrap_us = 0.0;           ///< 0: the sensor's clock does not wrap
    std::vector<double> offset_us;  ///< [rings] time of each beam within a firing
    /// True: the head angle of a beam is interpolated from neighbouring azimuths. False:
    /// the head rotates evenly.
    bool interpolates = false;
    /// [columns per revolution] for a sensor that fires at fixed azimuths, starting at
    /// 180 degrees, and whose clock alone defines the times: true if it fires there.
    /// Empty: the sensor fires at any azimuth, and each packet's stamp defines the time.
    std::vector<bool> fires = {};
    /// intensities may exceed 1; the intensity that counts as 1 is determined from all of
    /// them
    bool is_wide = false;
};

class Decoder {
public:
    virtual ~Decoder() = default;
    /// Decodes a packet for which find_product() returns this product.
    /// @throws DataError if the packet is invalid
    virtual Packet decode(std::string_view bytes) const = 0;
    virtual const Timing& timing() const = 0;
    /// Returns the rotating sensor, highest ring first.
    /// @param columns  columns per revolution
    virtual SpinningSensor sensor(int columns, double rate_hz) const = 0;
    virtual std::string about() const = 0;  ///< product and source of its angles
};

struct OusterFormat;

/// Calibration data of a sensor that are not part of its packets.
struct Calibration {
    std::string correction = {};  ///< text of Hesai's angle correction; may be empty
    /// Format from the sensor's metadata. Null: not an Ouster, or the metadata is
    /// missing.
    std::shared_ptr<const OusterFormat> ouster = {};
};

/// A known kind of packet.
struct Product {
    const char* name;
    /// test by size and header; null for Ouster, whose packets have no identification
    bool (*is)(std::string_view bytes);
    /// Creates a decoder, or null if packets of the product are not supported.
    /// @throws DataError if a calibration is damaged or belongs to another sensor
    std::unique_ptr<Decoder> (*make)(const char* name, const Calibration& calibration);
    const char* driver = "";  ///< driver that makes clouds from unsupported packets
};
/// Finds the product of a packet by size and header, or for Ouster by the size in the
/// metadata.
/// @return null if the packet is unknown
const Product* find_product(std::string_view bytes, const Calibration& calibration);
/// Returns what to do about a packet that is not decoded: "packets of a VLS-128, expected
/// those of ...".
std::string unknown_text(const Product* product, std::string_view bytes);

/// Create the decoders of Velodyne's and Hesai's products, and of Ouster's products.
std::unique_ptr<Decoder> make_block_decoder(const char* name, const Calibration& calibration);
std::unique_ptr<Decoder> make_ouster_decoder(const char* name, const Calibration& calibration);

}  // namespace relidar::packets
