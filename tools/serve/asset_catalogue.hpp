// SPDX-License-Identifier: Apache-2.0
// Lists the assets (saved models of actors) that clients can insert into scenes.
#pragma once

#include <string>
#include <vector>

#include <relidar/simulate/assets.hpp>

namespace relidar::serve {

class AssetCatalogue {
public:
    /// Reads the descriptions of all assets in the folders, but not their surfels.
    /// @throws DataError if a folder cannot be read
    /// @throws UsageError if two assets have the same name
    explicit AssetCatalogue(const std::vector<std::string>& folders);

    struct CatalogueEntry {
        std::filesystem::path folder;  ///< Folder of the asset.
        AssetDescription facts;
    };
    const std::vector<CatalogueEntry>& entries() const { return entries_; }
    const CatalogueEntry* find_asset(const std::string& asset_name) const;

private:
    std::vector<CatalogueEntry> entries_;
};

}  // namespace relidar::serve
