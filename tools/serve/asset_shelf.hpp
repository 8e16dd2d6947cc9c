// SPDX-License-Identifier: Apache-2.0
// Catalogue of the assets that clients can insert into scenes.
#pragma once

#include <string>
#include <vector>

#include <relidar/simulate/assets.hpp>

namespace relidar::serve {

/// Catalogue of assets. It is immutable after construction, so that any thread may read
/// it.
class AssetShelf {
public:
    /// Reads only the descriptions of assets, because many are never used. The surfels
    /// are read when an asset is inserted.
    /// @param folders folders of `relidar assets`
    /// @throws DataError if a folder cannot be read
    /// @throws UsageError if two assets have the same name
    explicit AssetShelf(const std::vector<std::string>& folders);

    struct Entry {
        std::filesystem::path folder;  ///< Folder of the asset.
        AssetFacts facts;
    };
    const std::vector<Entry>& entries() const { return entries_; }
    /// Returns an asset, or null if the name is unknown.
    const Entry* find(const std::string& name) const;

private:
    std::vector<Entry> entries_;
};

}  // namespace relidar::serve
