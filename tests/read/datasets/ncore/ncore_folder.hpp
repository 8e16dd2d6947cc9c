// SPDX-License-Identifier: Apache-2.0
// The log that NCore's writer wrote from the synthetic street in this folder, as folders
// whose files tests can change. tools/dev/write_ncore explains how the log was made.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "base/codecs/zarr.hpp"
#include "support/logs.hpp"

namespace relidar::test {

inline std::filesystem::path ncore_fixture(const std::string& name) {
    return std::filesystem::path(RELIDAR_SOURCE_DIR) / "tests/read/datasets/ncore" / name;
}

struct NcoreFolder : LogFolder {
    /// Folders of the stores. The second store has the LiDARs.
    std::filesystem::path main = folder / "street.ncore4.zarr",
                          lidars = folder / "street.ncore4-lidars.zarr/lidars";

    explicit NcoreFolder(const std::string& name) : LogFolder(name, "log") {
        for (const char* store : {"street.ncore4.zarr", "street.ncore4-lidars.zarr"}) {
            std::filesystem::create_directories(folder / store);
            const std::string archive = ncore_fixture(std::string(store) + ".itar").string();
            EXPECT_EQ(std::system(("tar -xf " + archive + " -C " + (folder / store).string()).c_str()), 0);
        }
    }

    std::vector<std::filesystem::path> frames(const std::string& lidar) const {
        std::vector<std::filesystem::path> found;
        for (const auto& entry : std::filesystem::directory_iterator(lidars / lidar / "frames"))
            if (entry.is_directory()) found.push_back(entry.path());
        return found;
    }
    static nlohmann::json read_json(const std::filesystem::path& file) {
        return nlohmann::json::parse(read_text(file));
    }
    static void write_json(const std::filesystem::path& file, const nlohmann::json& json) {
        write_text(file, json.dump());
    }

    /// Keeps some rays of an array of shape [lines, rays, values], uncompressed.
    template <class T>
    static void keep_rays(const std::filesystem::path& frame, const std::string& array,
                          const std::vector<std::size_t>& kept) {
        const ZarrStore store(frame);
        nlohmann::json head = read_json(frame / array / ".zarray");
        std::vector<std::size_t> shape = head["shape"];
        const std::size_t axis = array.starts_with("ray_bundle_returns/") ? 1 : 0;
        const auto values = read_zarr_array<T>(store, array, shape);
        const std::size_t n_lines = axis == 1 ? shape[0] : 1, n_rays = shape[axis],
                          n_values = values.size() / n_lines / n_rays;
        std::string bytes;
        for (std::size_t line = 0; line < n_lines; ++line)
            for (const std::size_t ray : kept)
                bytes.append(reinterpret_cast<const char*>(&values[(line * n_rays + ray) * n_values]),
                             n_values * sizeof(T));
        shape[axis] = kept.size();
        head["shape"] = head["chunks"] = shape;
        head["compressor"] = nullptr;
        std::filesystem::remove_all(frame / array);
        write_json(frame / array / ".zarray", head);
        write_text(frame / array / (shape.size() == 1 ? "0" : "0.0"), bytes);
    }
};

}  // namespace relidar::test
