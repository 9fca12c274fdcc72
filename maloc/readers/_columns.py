"""Column names met in the wild and what they mean; names are compared without case or marks."""

from __future__ import annotations

import re

from maloc.readers._text import Table

DETECTION = {
    "time": "time timestamp datetime date_time time_utc timestamp_utc datetime_utc detection_time "
    "date_and_time_utc detection_timestamp_utc detection_time_utc datecollectedutc ts "
    "time_local local_time timestamp_local datetime_local",
    "epo": "epo epoch unix unix_time unix_timestamp epoch_s",
    "frac": "frac fraction fractional_second",
    "receiver": "receiver receiver_id receiver_sn receiver_serial receiver_serial_number "
    "serial serial_number hydro hydrophone sensor_id",
    "tag": "tag tag_id transmitter transmitter_id full_id acoustic_tag_id tagname",
    "codespace": "codespace code_space transmitter_codespace",
    "signal": "signal signal_strength signal_db signal_strength_db",
    "noise": "noise noise_db",
    "snr": "snr signal_to_noise_ratio",
    "sensor": "sensor sensor_value data",
    "sensor_unit": "sensor_unit unit",
    "depth": "depth",
    "station": "station station_name",
}
RECEIVER = {
    "receiver": "receiver serial receiver_id serial_number receiver_serial receiver_serial_number "
    "receiver_sn ins_serial_no hydro hydrophone station station_name station_no name id",
    "x": "x easting utm_x hx x_m",
    "y": "y northing utm_y hy y_m",
    "longitude": "longitude lon long lng deploy_longitude deploy_long deploy_lon longitude_deg "
    "decimallongitude stn_long",
    "latitude": "latitude lat deploy_latitude deploy_lat latitude_deg decimallatitude stn_lat",
    "depth": "depth z depth_m hz receiver_depth instrument_depth deploy_depth device_depth",
    "sync_tag": "sync_tag synctag sync_tag_id sync transmitter beacon beacon_id",
    "start": "start start_utc start_time start_time_utc deploy_date_time deploy_date deployed "
    "deploy_date_time_yyyy_mm_ddthh_mm_ss "
    "deployment_start",
    "end": "end end_utc end_time end_time_utc stop stop_utc stop_time recover_date_time "
    "recovery_date recover_date recover_date_time_yyyy_mm_ddthh_mm_ss deployment_end",
    "sd": "sd position_sd sd_m receiver_sd",
}
TAG = {
    "tag": "tag tag_id transmitter acoustic_tag_id full_id tag_code tagname code transmitter_id "
    "tag_id_code id_code signal",
    "codespace": "codespace code_space transmitter_codespace tag_code_space",
    "receiver": "receiver receiver_id receiver_sn serial hydro",
    "animal": "animal animal_id fish fish_id individual catalognumber name",
    "sensor": "sensor sensor_type sensor_function",
    "slope": "slope sensor_slope",
    "intercept": "intercept sensor_intercept",
    "min_delay": "min_delay step1_min_delay min_delay_s min_interval burst_min delay_min",
    "max_delay": "max_delay step1_max_delay max_delay_s max_interval burst_max delay_max",
    "start": "start start_utc release_date release_date_time utc_release_date_time release",
    "end": "end end_utc recapture_date removal_date",
}
TOA = {
    "ping": "ping",
    "tag": "tag",
    "sound_speed": "sound_speed ss",
    "depth": "depth",
}


def plain(name: str) -> str:
    """Return a name in lower case, words joined by underscores: "Station Name" -> station_name."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def find(columns: tuple[str, ...], synonyms: dict[str, str], roles: set[str]) -> dict[str, int]:
    """Return {role: index of its column}; of several candidates the first synonym listed wins."""
    simple = [plain(c) for c in columns]
    out: dict[str, int] = {}
    for role, words in synonyms.items():
        if role not in roles:
            continue
        for word in words.split():
            if word in simple:
                out[role] = simple.index(word)
                break
    return out


def locate(table: Table, synonyms: dict[str, str]) -> dict[str, int]:
    """Return {role: column}, refusing a name that heads two columns.

    Raises
    ------
    InputError
        If a column that is used occurs twice in the header.
    """
    simple = [plain(c) for c in table.columns]
    out = find(table.columns, synonyms, set(synonyms))
    for k in out.values():
        if simple.count(simple[k]) > 1:
            raise table.error(f"column '{table.columns[k]}' is there twice")
    return out


def unnamed(table: Table) -> list[int]:
    """Return the columns whose header is empty."""
    return [k for k, c in enumerate(table.columns) if not c.strip()]
