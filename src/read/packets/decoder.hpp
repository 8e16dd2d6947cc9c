// SPDX-License-Identifier: Apache-2.0
// Interface of the packet decoders of spinning LiDARs. Packets contain every firing, so
// rays without a return (dropped rays) are known. products.cpp lists the products.
// block_decoder.cpp decodes Velodyne and Hesai, ouster_metadata.cpp decodes Ouster.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar::packets {

struct ReceivedPacket {
    std::int64_t stamp_ns = 0;  ///< time at which it was received
    std::string_view bytes;
};

struct DecodedReturn {
    float range_m = 0.0f;    ///< distance from the origin of the beam; 0 means no return
    float intensity = 0.0f;  ///< 0 to 1
};

/// One firing of all beams.
struct LaserFiring {
    /// index of the firing in the packet; also counts firings that were not measured
    int slot = 0;
    double after_us = 0.0;  ///< time between the packet's time and the first beam of the firing
    /// Azimuth of the head at the start of the firing, clockwise from the sensor's x
    /// axis, in [0, 360).
    double azimuth_deg = 0.0;
    int sequence = 0;  ///< index of the firing sequence
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
    /// Number of firing sequences, above 1 if the sensor alternates between several sets
    /// of lasers. A column of a scan contains one firing of each sequence.
    int n_sequences = 1;
    /// time after which the sensor's clock restarts at 0; 0 if it never restarts
    double wrap_us = 0.0;
    /// [rings] time between the first firing of a column and the firing of each beam
    std::vector<double> offset_us;
    /// True if the head azimuth of each beam is interpolated between consecutive firings.
    /// False if the rotation rate is assumed to be constant.
    bool interpolates = false;
    /// [columns per revolution] For a sensor that fires at fixed azimuths (columns): true
    /// if it fires at this column. Column 0 is at 180 degrees. Empty for a sensor that
    /// can fire at any azimuth.
    std::vector<bool> fires = {};
    /// True if intensities can exceed 1. If they do, they are divided by the 99.5th
    /// percentile of the intensities of the topic.
    bool is_wide = false;

    bool has_fixed_columns() const { return !fires.empty(); }
    /// Returns true if the sensor fires at a column of any revolution. Columns count on
    /// from one revolution to the next.
    bool fires_at(std::int64_t column) const {
        const auto n = std::int64_t(fires.size());
        return fires[std::size_t((column % n + n) % n)];
    }
};

class PacketDecoder {
public:
    virtual ~PacketDecoder() = default;
    /// Decodes a packet of the product that this decoder supports.
    /// @throws DataError if the packet is invalid
    virtual DecodedPacket decode_packet(std::string_view packet_bytes) const = 0;
    virtual const FiringTiming& timing() const = 0;
    /// Returns the sensor, highest beam first.
    virtual SpinningSensor make_sensor(int columns_per_revolution, double rotation_rate_hz) const = 0;
    /// Returns the name of the product and the source of its beam angles.
    virtual std::string describe_product() const = 0;
};

// Angle correction file of a Hesai sensor: the angles of each laser of one unit in
// degrees, as measured by the manufacturer, azimuth clockwise. The first line is "Laser
// id,Elevation,Azimuth" or "Channel,Elevation,Azimuth".

struct LaserAngles {
    double elevation_deg = 0.0, azimuth_deg = 0.0;
};

struct AngleCorrection {
    std::string where;                ///< name of the file
    bool is_named = false;            ///< true if the file has the same name as the recording
    std::vector<LaserAngles> lasers;  ///< measured angles of laser 1, 2 and so on
    std::string problem = {};         ///< why the file cannot be read; empty if it was read
};

/// Parses an angle correction file.
/// @param where  name of the file, for error messages
/// @throws DataError if a line is invalid, or if a laser is missing
AngleCorrection parse_angles(const std::string& csv_text, const std::string& where);

/// Finds and reads the angle correction files of a recording. Reads the .csv files that
/// have the names of the recording's files. If there are none, reads all .csv files in
/// its folder that begin like an angle correction. For a ROS 2 bag, also searches the
/// folder above. A damaged file has no lasers.
/// @throws DataError if the file with the name of the recording is damaged
std::vector<AngleCorrection> find_angle_files(const std::vector<std::filesystem::path>& recording_files);

struct OusterMetadata;

struct DecoderCalibration {
    std::vector<AngleCorrection> corrections = {};  ///< angle corrections of Hesai's sensors
    /// Metadata of an Ouster sensor; null for other sensors, or if missing.
    std::shared_ptr<const OusterMetadata> ouster = {};
    /// For an RS-LiDAR-16: true if each firing in a packet has two returns.
    bool has_two_returns = false;
};

/// What the packets of a product have in common.
struct PacketSignature {
    struct Byte {
        std::size_t at = 0;
        int value = -1;  ///< -1: any value
    };
    std::string_view head;       ///< first bytes
    std::size_t size = 0;        ///< 0: any size above 500 bytes
    std::size_t n_optional = 0;  ///< size of optional fields at the end
    Byte first = {}, second = {};
};

/// A LiDAR product whose packets relidar recognises.
struct LidarProduct {
    const char* name;
    PacketSignature signature;
    /// Creates a decoder. Null if relidar recognises the packets but cannot decode them.
    /// @throws DataError if a calibration is damaged or belongs to another sensor
    std::unique_ptr<PacketDecoder> (*make)(const char* name, const DecoderCalibration& calibration);
    /// driver that the user can use if relidar cannot decode the packets
    const char* driver = "";
};
/// Finds the product that sent a packet by the size and the header of the packet. For an
/// Ouster, compares the size with its metadata. Returns null if no product matches.
const LidarProduct* find_product(std::string_view packet_bytes, const DecoderCalibration& calibration);
/// Returns the error message for packets that relidar cannot decode.
std::string unsupported_text(const LidarProduct* product, std::string_view packet_bytes);

/// Returns true if the packets of an RS-LiDAR-16 contain two returns per firing. The
/// packets do not state this. With two returns, the time between packets is half as long.
bool is_dual_rs16(const std::vector<ReceivedPacket>& packets);

// Creators of decoders: for Velodyne, Hesai and RS-LiDAR-16, and for Ouster.
std::unique_ptr<PacketDecoder> make_block_decoder(const char* name, const DecoderCalibration& calibration);
std::unique_ptr<PacketDecoder> make_ouster_decoder(const char* name, const DecoderCalibration& calibration);

// Livox sensors that use the protocol of Livox SDK2 (Mid-360, HAP). They do not rotate.
// As in Livox's driver, the packets of 0.1 s form one cloud.

/// Encoding and message type of the clouds that join_livox_packets() returns.
inline constexpr const char *kLivoxEncoding = "ros1", *kLivoxType = "livox_ros_driver2/CustomMsg";
/// Duration of a cloud: slightly below 0.1 s, so that one starts about every 0.1 s.
inline constexpr std::int64_t kLivoxCloud_ns = 99'000'000;
inline constexpr std::size_t kMostLivoxPackets = 4096;  ///< maximum number of packets in one cloud

/// Returns false for packets of the IMU.
bool is_livox_packet(std::string_view packet_bytes);

/// Joins packets to a cloud, a message of Livox's driver in the encoding of ROS 1. Omits
/// rays without a return, whose directions the packets do not contain.
/// @param packed_packets  for each packet: time stamp (64 bits), length (32 bits), bytes
/// @throws DataError if the list of packets is damaged
std::string join_livox_packets(std::string_view packed_packets, std::string_view frame_id);

}  // namespace relidar::packets
