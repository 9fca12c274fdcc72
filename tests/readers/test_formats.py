"""Every export known, by the rows that formats.md gives: the same times, ids, and notices."""

import csv
import io
import zipfile

import numpy as np
import polars as pl
import pytest

from maloc.data import Receivers, toa_matrix
from maloc.errors import InputError
from maloc.readers import read_detections, read_events, read_positions, read_receivers
from maloc.readers.check import check

NS = 1_000_000_000
VUE = "Date and Time (UTC),Receiver,Transmitter,Transmitter Name,Station Name"


def ns(stamp):
    return int(np.datetime64(stamp, "ns").astype(np.int64))


# --- Fathom/VDAT ------------------------------------------------------------------------------

DESC_2 = (
    "DET_DESC,Device Time (UTC),Time,Time Offset (h),Time Correction (s),Model,Serial Number,"
    "Channel,Detection Type,Full ID,ID,Raw Data,Transmitter Serial,Signal Strength (dB),"
    "Noise (dB),Gain (dB),Quality Score,Station Name,Latitude,Longitude,GPS HDOP"
)
CLOCK_REF = (
    "CLOCK_REF_DESC,Device Time (UTC),Time,Time Offset (h),Time Correction (s),Model,"
    "Serial Number,External Time (UTC),External Difference (s),Source"
)
LOG_2 = f"""\ufeffVEMCO DATA LOG,2.0.0,vdat-11.0.1-20240830-d01c0d-release
RECORD TYPE,FIELD,FIELD,FIELD,FIELD,FIELD,FIELD,FIELD
{DESC_2}
{CLOCK_REF}
CLOCK_REF,2021-06-01 10:00:00,,,,VR2Tx-69,480102,2021-06-01 10:00:00,0,INITIALIZATION
DET,2021-06-01 10:00:00.2170,2021-06-01 10:00:00.7170,0,0.500000,VR2Tx-69,480102,1,PPM,\
A69-1602-12345,12345,,,,,,,,,,
DET,2021-06-01 10:00:30.0837,,,,HR2-180,461396,1,HR,H170-1802-501,501,,,54.1,31.0,,210,,,,
NOVELTY,2021-06-01 10:00:30.0837,7
"""


def test_vdat_2_rows_with_and_without_corrected_time(read):
    d = read(LOG_2)
    assert (d.time - ns("2021-06-01T10:00:00")).tolist() == [717_000_000, 30_083_700_000]
    assert d.receiver.tolist() == ["480102", "461396"]
    assert d.tag.tolist() == ["A69-1602-12345", "H170-1802-501"]
    assert d.extra["signal"].tolist()[1] == 54.1 and d.extra["quality"][1] == 210
    said = [str(n) for n in d.report.notes]
    assert any("1 of 2 rows have no corrected time" in s for s in said)
    assert any("no detections: CLOCK_REF (1)" in s for s in said)
    assert any("not known, passed over: NOVELTY (1)" in s for s in said)
    device = read(LOG_2, clock="device")
    assert device.time[0] == ns("2021-06-01T10:00:00.217")
    with pytest.raises(InputError, match="line 7, column 'Time': no corrected time"):
        read(LOG_2, clock="corrected")


def test_vdat_1_has_its_own_columns_in_its_own_order(read):
    log = (
        "VEMCO DATA LOG,1.0.0,vdat-9\n"
        "DET_DESC,Device Time (UTC),Time,Time Offset (h),Time Correction (s),Model,Serial Number,"
        "Detection Type,Full ID,ID,Signal Strength (dB),Noise (dB),Quality Score,Decoder,"
        "Sensor Value,Sensor Unit\n"
        "DET,2021-06-01 10:00:00.2170,2021-06-01 12:00:00.7170,2,0.5,VR2Tx-69,480102,PPM,"
        "A69-9006-501,501,,,,,28.5,m\n"
    )
    d = read(log)
    assert d.time.tolist() == [ns("2021-06-01T10:00:00.717")]  # hours are a zone, no correction
    assert "shifted by +2 h" in str(d.report)
    assert d.extra["depth"].tolist() == [28.5]


def test_vdat_sensor_records_and_pasted_logs(read):
    sens = DESC_2.replace("DET_DESC", "DET_SENS_DESC") + (
        ",Transmitter Type,Sensor Function,Sensor Value,Sensor Unit,Sensor Precision,"
        "Definition Source"
    )
    row = "2021-06-01 10:00:00.2170,,,,VR2Tx-69,480102,1,PPM,A69-9006-501,501,77,,,,,,,,,"
    log = (
        f"VEMCO DATA LOG,2.0.0,x\n{DESC_2}\n{sens}\nDET,{row}\n"
        f"DET_SENS,{row},,Temperature,12.5,deg C,,\n"
        "VEMCO DATA LOG,2.0.0,x\n"
        "DET_DESC,Full ID,Serial Number,Device Time (UTC)\n"
        "DET,A69-1602-1,480103,2021-06-01 10:00:01.5\n"
    )
    d = read(log)
    assert d.tag.tolist() == ["A69-9006-501", "A69-1602-1"]
    assert d.receiver.tolist() == ["480102", "480103"]
    assert d.extra["temperature"][0] == 12.5 and np.isnan(d.extra["temperature"][1])
    with pytest.raises(InputError, match="line 3.*4 fields in a DET record of 3 columns"):
        read("VEMCO DATA LOG,2.0.0,x\nDET_DESC,Full ID,Serial Number\nDET,A,480103,2021\n")


def test_vdat_split_folder(tmp_path):
    folder = tmp_path / "x.csv-fathom-split"
    folder.mkdir()
    (folder / "DET.csv").write_text(
        "Device Time (UTC),Time,Serial Number,Full ID\n2021-06-01 10:00:00.2170,,480102,A69-1-7\n"
    )
    (folder / "TEMP.csv").write_text("Device Time (UTC),Serial Number,Ambient (deg C)\n,,\n")
    d = read_detections(folder)
    assert d.tags == ("A69-1-7",) and "TEMP.csv" in str(d.report)


def test_innovasea_with_one_header_line(read):
    head = "Device Time (UTC),Time,Time Correction (s),Serial Number,Full ID,Raw Data,Model,Colour"
    rows = "2021-06-01 10:00:00.2170,2021-06-01 10:00:00.7170,0.5,480102,A69-1-7,,VR2Tx,red\n"
    d = read(f"{head}\n{rows}")
    assert d.time[0] == ns("2021-06-01T10:00:00.717") and d.report.format == "Innovasea CSV"
    assert "columns not used: Colour" in str(d.report)


def test_corrected_and_device_times_side_by_side_are_loudly_warned_of(case12):
    corrected, raw = case12
    mixed = read_detections(corrected[0], *raw[1:])
    assert any("corrected times in some files" in n.text for n in mixed.report.warnings)
    assert not read_detections(*corrected).report.warnings


# --- clocks -----------------------------------------------------------------------------------


@pytest.fixture
def case12(shared_dir):
    folder = shared_dir / "cases" / "12-vdat-corrected-time"
    return sorted(folder.glob("VR2Tx_*")), sorted(folder.glob("uncorrected_*"))


def test_vue_events_and_the_linear_correction_by_them(tmp_path):
    events = tmp_path / "events.csv"
    events.write_text(
        "Date and Time (UTC),Receiver,Description,Data,Units\n"
        "2021-06-01 09:00:00,VR2W-301001,Initialization,,\n"
        "2021-06-01 12:00:00,VR2W-301001,Temperature,12.5,C\n"
        "2021-06-02 09:00:00,VR2W-301001,PC Time,2021-06-02 08:59:52,\n"
        "2021-06-02 09:00:00,VR2W-301002,PC Time,2021-06-02 11:00:00,\n"
        "2021-06-02 10:00:00,VR2W-301001,Initialization,,\n"
    )
    found = read_events(events)
    assert found.kind.tolist().count("PC Time") == 2
    time, receiver, value = found.measured("temperature")
    assert time.tolist() == [ns("2021-06-01T12:00")] and value.tolist() == [12.5]
    assert receiver.tolist() == ["301001"]
    assert "another zone" in str(found.report) and len(found.references) == 3
    heard = [
        ("2021-06-01 08:59:00.5", 301001),
        ("2021-06-01 09:00:00.5", 301001),
        ("2021-06-01 21:00:00.5", 301001),
        ("2021-06-02 09:30:00.5", 301001),
        ("2021-06-02 10:30:00.5", 301001),
        ("2021-06-01 09:00:00.5", 301002),
    ]
    rows = [f"{t},VR2W-{r},A69-1-7,," for t, r in heard]
    vue = tmp_path / "vue.csv"
    vue.write_text("\n".join([VUE, *rows]) + "\n")
    raw = read_detections(vue)
    d = read_detections(vue, events, clock="linear")
    shift = (d.time - raw.time) / NS
    # 8 s lost in the 24 h after the clock was set, on at that rate, and set again
    expected = [0, -0.5 * 8 / 86400, -4 - 0.5 * 8 / 86400, -8 * 24.5 / 24 - 0.5 * 8 / 86400, 0, 0]
    np.testing.assert_allclose(shift, expected, atol=2e-9)
    assert [n.text for n in d.report.warnings if "301001" in n.text] == [
        "1 detections of 301001 have no comparison of clocks: device times kept"
    ]
    with pytest.raises(InputError, match="no comparisons of clocks"):
        read_detections(vue, clock="linear")


def test_a_clock_that_was_set_in_between(read):
    log = (
        f"VEMCO DATA LOG,2.0.0,x\n{CLOCK_REF}\n"
        "CLOCK_SET_DESC,Device Time (UTC),Model,Serial Number,Prior Device Time (UTC),"
        "Prior Difference (s),Source\n"
        "DET_DESC,Device Time (UTC),Serial Number,Full ID\n"
        "CLOCK_REF,2021-06-01 00:00:00,,,,VR2Tx,480102,2021-06-01 00:00:00,0,INITIALIZATION\n"
        "CLOCK_SET,2021-06-02 00:00:10,VR2Tx,480102,2021-06-02 00:00:00,10,PC\n"
        "CLOCK_REF,2021-06-03 00:00:10,,,,VR2Tx,480102,2021-06-03 00:00:12,2,OFFLOAD\n"
        "DET,2021-06-01 12:00:00.0,480102,A69-1-7\n"
        "DET,2021-06-02 12:00:10.0,480102,A69-1-7\n"
    )
    raw, d = read(log), read(log, clock="linear")
    np.testing.assert_allclose((d.time - raw.time) / NS, [5.0, 1.0], atol=1e-9)


# --- other makers -----------------------------------------------------------------------------

WHS = """WHS FSK Receiver Data File

Receiver Configuration:
Code Type:          FSK
Serial Number:      WHS3K-1234567
Beacon ID:          60001

Receiver Settings:
GMT Correction:     {gmt}

Decoded Tag Data:
Date      Time             TOA       Tag ID    Type     Value     Power
=======================================================================
04/09/24  22:50:03     0.43875        37910       P       9.1        12
{second}  22:50:18     0.43870        37910                          13
04/09/24  22:50:20     damaged

Receiver Sensor Messages:
Date      Time      Sensor   Temp     Press   Battery  Tilt-X  Tilt-Y  Tilt-Z
04/11/24  21:44:00  T / P    1534         0
"""


def test_lotek_text(read):
    d = read(WHS.format(gmt="-05:00", second="04/19/24"), name="WHS3K.TXT")
    assert d.time[0] == ns("2024-04-10T03:50:03.438750") and d.receivers == ("1234567",)
    assert d.time[1] - d.time[0] == 10 * 86400 * NS + 15 * NS - 50_000
    assert d.extra["sensor"][0] == 9.1 and d.extra["power"].tolist() == [12, 13]
    said = str(d.report)
    assert "beacon) is 60001" in said and "1 rows that cannot be read left out (lines 16)" in said
    both = WHS.format(gmt="00:00", second="04/10/24")
    with pytest.raises(InputError, match="day and month cannot be told apart.*lotek-mdy"):
        read(both)
    assert read(both, format="lotek-dmy").time[0] == ns("2024-09-04T22:50:03.438750")
    assert read(both, format="lotek-mdy").time[0] == ns("2024-04-09T22:50:03.438750")
    with pytest.raises(InputError, match="dates in two orders"):
        read(WHS.format(gmt="00:00", second="13/09/24").replace("04/09/24", "04/19/24"))
    nowhere = WHS.format(gmt="00:00", second="04/19/24").replace("GMT", "Other")
    with pytest.raises(InputError, match="zone of its times is not known.*--tz"):
        read(nowhere)
    assert read(nowhere, tz="Etc/GMT+1").time[0] == ns("2024-04-09T23:50:03.438750")


@pytest.mark.parametrize("header", ["Receiver,DateTime,FracSec,Dec,Hex,Power\n", ""])
def test_lotek_jsats(read, header):
    rows = "WHS4K-1900132,45391.95142361,0.43875,37910,9416,12\n" * 2
    rows += "WHS4K-1900132,45391.95159722,0.43870,37910,9416,13\n"
    with pytest.raises(InputError, match="local times.*--tz"):
        read(header + rows)
    d = read(header + rows, tz="UTC")
    assert d.time.tolist() == [ns("2024-04-09T22:50:03.43875"), ns("2024-04-09T22:50:18.43870")]
    assert d.receivers == ("1900132",) and d.tags == ("37910",)
    assert "1 exact duplicate removed" in str(d.report)
    assert read(header + rows, tz="America/New_York").time[0] - d.time[0] == 4 * 3600 * NS


# --- networks ---------------------------------------------------------------------------------

OTN_2025 = (
    "collectionCode,catalogNumber,organismID,scientificName,commonName,dateLastModified,"
    "detectedBy,station,receiver,bottomDepth,receiverDepth,tagName,codeSpace,sensorName,"
    "sensorRaw,sensorType,sensorValue,sensorUnit,dateCollectedUTC,uncorrectedDateCollectedUTC,"
    "decimalLongitude,decimalLatitude,geodeticDatum,geometry,localArea,citation,unqDetecID,"
    "contactPOC,contactPI\n"
    "XX.TEST,XX-1,XX-1,Fish fish,test fish,2021-07-01,XX.TEST,T01,301001,20.0,19.0,"
    "A69-1602-12345,A69-1602,,,pinger,,,2021-06-01 10:00:00,2021-06-01 09:59:58,-63.50000,"
    '44.40000,EPSG:4326,0101,TEST,"A, B. 2021",XX-A69-1602-12345-1,,\n'
    "XX.TEST,XX-1,XX-1,Fish fish,test fish,2021-07-01,XX.TEST,release,,,,A69-1602-12345,,,,,,,"
    "2021-05-01 00:00:00,2021-05-01 00:00:00,-63.50000,44.40000,EPSG:4326,0101,TEST,"
    '"A, B. 2021",XX-release-1,,\n'
)
OTN_OLD = (
    "collectioncode,catalognumber,station,receiver,bottom_depth,receiver_depth,tagname,"
    "codespace,sensorvalue,sensorunit,datecollected,timezone,longitude,latitude,unqdetecid\n"
    "XX.TEST,XX-1,T01,301001,20.0,19.0,A69-1602-12345,A69-1602,,,2021-06-01 10:00:00,{zone},"
    "-63.5,44.4,1\n"
)


def test_otn_extracts(read):
    d = read(OTN_2025)
    assert len(d) == 1 and d.tags == ("A69-1602-12345",) and d.receivers == ("301001",)
    assert d.time[0] == ns("2021-06-01T10:00:00") and d.extra["animal"][0] == "XX-1"
    assert (d.extra["longitude"][0], d.extra["latitude"][0]) == (-63.5, 44.4)
    assert "1 release set aside" in str(d.report)
    assert read(OTN_2025, clock="device").time[0] == ns("2021-06-01T09:59:58")
    units = OTN_2025.replace("\n", "\n" + "," * 18 + "UTC,UTC,degrees_east,,,,,,,,\n", 1)
    assert len(read(units)) == 1 and "line of units skipped" in str(read(units).report)
    assert read(OTN_OLD.format(zone="UTC")).time[0] == ns("2021-06-01T10:00:00")
    with pytest.raises(InputError, match="'timezone' says AST.*--tz"):
        read(OTN_OLD.format(zone="AST"))
    assert read(OTN_OLD.format(zone="AST"), tz="Etc/GMT+4").time[0] == ns("2021-06-01T14:00:00")


GLATOS = (
    "animal_id,detection_timestamp_utc,glatos_array,station_no,transmitter_codespace,"
    "transmitter_id,sensor_value,sensor_unit,deploy_lat,deploy_long,receiver_sn,tag_type,"
    "tag_model,tag_serial_number,common_name_e,station,min_lag,record_status\n"
    "9,2021-06-01 10:00:00,TST,2,A69-1602,12345,,,43.39165,-83.99264,301001,,,,walleye,TST-002,"
    "258,OK\n"
)


def test_glatos_and_etn(read):
    d = read(GLATOS)
    assert d.tags == ("A69-1602-12345",) and d.extra["animal"].tolist() == [9]
    assert d.extra["station"].tolist() == ["TST-002"] and d.extra["latitude"][0] == 43.39165
    assert d.report.format == "GLATOS detection export"
    etn = read(
        "date_time,acoustic_tag_id,receiver_id,snr\n2021-05-02T22:23:37.384Z,OPi-111,1514,14\n"
    )
    assert etn.report.format == "ETN detection extract"
    assert etn.time[0] == ns("2021-05-02T22:23:37.384") and etn.extra["snr"][0] == 14


DEPLOYMENTS = {
    "glatos": "station,glatos_array,station_no,deploy_lat,deploy_long,recover_lat,recover_long,"
    "deploy_date_time,recover_date_time,instrument_depth,ins_serial_no\n"
    "A-1,A,1,43.4,-83.9,43.4,-83.9,2021-05-01 10:00,,8,301001\n"
    "A-2,A,2,43.402,-83.9,43.402,-83.9,2021-05-01 10:00,,8,301002\n",
    "etn": "deployment_id,receiver_id,station_name,deploy_date_time,deploy_latitude,"
    "deploy_longitude,recover_date_time,download_file_name\n"
    "1,VR2AR-301001,T_0m,2021-05-01T10:00:00Z,43.4,-83.9,,x.vrl\n"
    "2,VR2AR-301002,T_1m,2021-05-01T10:00:00Z,43.402,-83.9,,y.csv\n",
    "otn": "Deployment metadata,,,,\nof the array,,,,\n\n"
    "OTN_ARRAY,STATION_NO,DEPLOY_DATE_TIME   (yyyy-mm-ddThh:mm:ss),DEPLOY_LAT,DEPLOY_LONG,"
    "INS_MODEL_NO,INS_SERIAL_NO,RECOVERED,RECOVER_DATE_TIME (yyyy-mm-ddThh:mm:ss)\n"
    "A,1,2021-05-01T10:00:00,43.4,-83.9,VR2W,301001,y,\n"
    "A,2,2021-05-01T10:00:00,43.402,-83.9,VR2W,301002,y,\n",
    "vps": "Project,,,,,,\nName,Latitude,Longitude,Device,Device Depth,Start Time,End Time\n"
    "A1,43.4,-83.9,VR2W-301001,8,2021-05-01 10:00,\n,,,A69-1602-60001,,,\n"
    "A2,43.402,-83.9,VR2W-301002,8,2021-05-01 10:00,\nB,43.4,-83.9,A69-1602-60009,,,\n",
}


@pytest.mark.parametrize("kind", DEPLOYMENTS)
def test_deployment_sheets(read, kind):
    r = read(DEPLOYMENTS[kind], read_receivers)
    assert {n.split("-")[-1] for n in r.names} == {"301001", "301002"}
    assert r.y[1] - r.y[0] == pytest.approx(222.2, abs=0.5) and abs(r.x[1] - r.x[0]) < 10
    assert set(r.start.tolist()) == {ns("2021-05-01T10:00")}
    if kind == "vps":
        assert r.sync_tag.tolist() == ["A69-1602-60001", ""] and r.depth.tolist() == [8, 8]
        assert "A69-1602-60009" in str(r.report)


def test_moorings_that_moved_are_said(read):
    moved = DEPLOYMENTS["glatos"].replace("43.402,-83.9,2021", "43.403,-83.9,2021")
    assert "301002 (111 m)" in str(read(moved, read_receivers).report)


def test_workbooks_are_read_sheet_by_sheet(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["notes"])
    sheet = book.create_sheet("Stations")
    for row in csv.reader(io.StringIO(DEPLOYMENTS["vps"])):
        sheet.append([float(v) if v.replace(".", "").lstrip("-").isdigit() else v for v in row])
    book.save(tmp_path / "project.xlsx")
    r = read_receivers(tmp_path / "project.xlsx")
    assert r.names == ("VR2W-301001", "VR2W-301002")
    assert r.sync_tag.tolist() == ["A69-1602-60001", ""]
    with pytest.raises(InputError, match="none of its 2 files holds detections"):
        read_detections(tmp_path / "project.xlsx")


# --- positions --------------------------------------------------------------------------------


def test_vps_positions_and_the_shift_of_its_frame(read):
    from pyproj import Transformer

    to_degrees = Transformer.from_crs("EPSG:32631", "EPSG:4326", always_xy=True)
    x, y = np.array([1057.84, 1060.02]), np.array([921.50, 920.11])
    lon, lat = to_degrees.transform(x + 646_000, y + 5_661_000)
    rows = [
        f"103,A69-1105-103,2021-06-01 10:00:{10 * i:02d},{x[i]},{y[i]},1.364,{lat[i]:.9f},"
        f"{lon[i]:.9f},3,6.5,,,1.36,,S12 S14 S16,S12 S14"
        for i in range(2)
    ]
    head = "TRANSMITTER,DETECTEDID,DATETIME,X,Y,D,LAT,LON,n,HPE,HPEm,TEMP,DEPTH,ACCEL,DRX,URX"
    p = read("\n".join([head, *rows]) + "\n", read_positions)
    assert p.tag.tolist() == ["A69-1105-103"] * 2 and p.xy[1].tolist() == [1060.02, 920.11]
    assert p.extra["hpe"].tolist() == [6.5, 6.5] and p.extra["heard"][0] == "S12 S14 S16"
    q = read("\n".join([head, *rows]) + "\n", read_positions, crs="EPSG:32631")
    np.testing.assert_allclose(q.xy - p.xy, [[646_000, 5_661_000]] * 2, atol=0.01)
    assert "metres lie 646000.0, 5661000.0 m from EPSG:32631" in str(q.report)
    half = q.at(np.array([ns("2021-06-01T10:00:05"), ns("2021-06-01T10:01:00")]))
    np.testing.assert_allclose(half[0], q.xy.mean(0))
    assert np.isnan(half[1]).all()


def test_other_tables_of_positions(read):
    atlas = read(
        '"TAG","TIME","X","Y","NBS","VARX","VARY","COVXY","SD"\n'
        "972006000345,1622548800217.5,650000.5,5900000.25,4,4,9,1,3\n",
        read_positions,
    )
    assert atlas.time[0] == 1622548800217_500_000 and atlas.tag[0] == "972006000345"
    assert (atlas.extra["sd_x"][0], atlas.extra["sd_y"][0]) == (2, 3)
    movebank = read(
        "event-id,visible,timestamp,location-long,location-lat,sensor-type,tag-local-identifier,"
        "individual-local-identifier,study-name\n"
        '1,true,2021-06-01 10:00:00.000,9.0,56.0,"gps","t1","fish1","test"\n'
        '2,false,2021-06-01 11:00:00.000,9.001,56.001,"gps","t1","fish1","test"\n',
        read_positions,
    )
    assert movebank.tag.tolist() == ["fish1"] * 2 and movebank.longitude[1] == 9.001
    assert "1 positions not visible: kept" in str(movebank.report)
    gps = read("ts,utm_x,utm_y\n2021-06-01T10:00:00.5Z,1,2\n", read_positions)
    assert gps.xy.tolist() == [[1.0, 2.0]] and gps.time[0] == ns("2021-06-01T10:00:00.5")
    with pytest.raises(InputError, match="VPS positions, not detections"):
        read("DETECTEDID,DATETIME,X,Y,HPE\nA-1,2021-06-01 10:00:00,1,2,3\n")


# --- packed, pasted, overlapping --------------------------------------------------------------


def rows(times, receiver=1, tag="A69-1-7"):
    return [f"{t},VR2W-{receiver},{tag},," for t in times]


def test_archives(tmp_path):
    with zipfile.ZipFile(tmp_path / "all.zip", "w") as z:
        z.writestr("a/one.csv", "\n".join([VUE, *rows(["2021-06-01 10:00:00.5"])]) + "\n")
        z.writestr("a/two.csv", "\n".join([VUE, *rows(["2021-06-01 10:00:01.5"], 2)]) + "\n")
        z.writestr("a/receivers.csv", "receiver,x,y\n1,0,0\n2,100,0\n")
        z.writestr("__MACOSX/a/._one.csv", "junk")
    d = read_detections(tmp_path / "all.zip")
    assert d.receivers == ("1", "2") and "receivers.csv" in str(d.report)
    r = read_receivers(tmp_path / "all.zip")
    assert r.names == ("1", "2")
    assert [f.format for f in check(tmp_path / "all.zip").files] == [
        "VUE detections CSV", "VUE detections CSV", "receivers table"]  # fmt: skip
    (tmp_path / "cut.zip").write_bytes((tmp_path / "all.zip").read_bytes()[:60])
    with pytest.raises(InputError, match="broken or locked zip"):
        read_detections(tmp_path / "cut.zip")


def stamps(n, start="2021-06-01T10:00:00.217", step=31_007):
    t = np.datetime64(start, "ms") + step * np.arange(n) + 13 * np.arange(n) ** 2
    return [str(v).replace("T", " ") for v in t]


def test_the_same_data_in_whole_seconds_gives_way(tmp_path):
    fine = stamps(30)
    (tmp_path / "fine.csv").write_text("\n".join([VUE, *rows(fine)]) + "\n")
    coarse = [t[:19] for t in fine]
    (tmp_path / "coarse.csv").write_text("\n".join([VUE, *rows([*coarse, "2021-06-02 01:00:00"])]))
    d = read_detections(tmp_path / "coarse.csv", tmp_path / "fine.csv")
    assert len(d) == 31 and "30 detections of 1 are in another file with fractions" in str(d.report)


def test_the_same_data_on_another_clock_is_refused(tmp_path):
    raw = stamps(30)
    shifted = [
        str(np.datetime64(t, "ms") + np.timedelta64(2400 + i, "ms")).replace("T", " ")
        for i, t in enumerate(raw)
    ]
    for name, times in (("raw.csv", raw), ("corrected.csv", shifted)):
        (tmp_path / name).write_text("\n".join([VUE, *rows(times)]) + "\n")
    with pytest.raises(InputError, match="corrected.csv: holds.*about 2.4. s apart"):
        read_detections(tmp_path / "raw.csv", tmp_path / "corrected.csv")
    other = stamps(30, step=29_003)  # another day of the same tag: nothing wrong with it
    (tmp_path / "corrected.csv").write_text("\n".join([VUE, *rows(other)]) + "\n")
    assert len(read_detections(tmp_path / "raw.csv", tmp_path / "corrected.csv")) == 59


def test_exports_with_other_columns_pasted_below(read):
    wide = "Date and Time (UTC),Receiver,Transmitter,Transmitter Name,Station Name,Sensor Value,x"
    first = "\n".join([VUE, *rows(stamps(3))])
    swapped = "Date and Time (UTC),Transmitter,Receiver"
    text = (
        f"{first}\n\n\ufeff{wide}\n2021-06-01 11:00:00.5,VR2W-2,A69-1-8,,S,7.5,\n"
        f"{rows(stamps(1))[0]},,\n{swapped}\n2021-06-01 12:00:00.5,A69-1-9,VR2W-3\n"
    )
    d = read(text)
    assert d.receiver.tolist() == ["1", "1", "1", "2", "3"]
    assert d.tag.tolist()[-2:] == ["A69-1-8", "A69-1-9"] and d.extra["sensor"][3] == 7.5
    said = str(d.report)
    assert "3 exports with different columns pasted together" in said
    assert "1 detections present in more than one part of the file" in said
    with pytest.raises(InputError, match="line 8, column 'Date and Time"):
        read(text.replace(f"{rows(stamps(1))[0]},,\n", "nonsense,VR2W-1,A69-1-7,,,,\n"))


def test_one_receiver_under_two_names_counts_once(tmp_path):
    (tmp_path / "vue.csv").write_text("\n".join([VUE, *rows(stamps(4))]) + "\n")
    lines = [f"{t},VR2W-1,A69-1-7" for t in stamps(4)]
    (tmp_path / "own.csv").write_text("time,receiver,tag\n" + "\n".join(lines) + "\n")
    d = read_detections(tmp_path / "own.csv", tmp_path / "vue.csv")
    assert len(d) == 4 and d.receivers == ("1",)


def test_a_detection_there_again_with_other_values(read):
    d = read(f"{VUE}\n2021-06-01 10:00:00.5,VR2W-1,A-1,,ST1\n2021-06-01 10:00:00.5,VR2W-1,A-1,,\n")
    assert len(d) == 1
    assert "there again with other values" in d.report.warnings[0].text


@pytest.mark.parametrize(("said", "hours"), [("UTC+2", 2), ("UTC-05:00", -5), ("GMT+0", 0)])
def test_a_zone_in_the_bracket_is_taken(read, said, hours):
    d = read(f"Date and Time ({said}),Receiver,Transmitter\n2021-06-01 12:00:00.5,VR2W-1,A-1\n")
    assert d.time[0] == ns("2021-06-01T12:00:00.5") - hours * 3600 * NS


def test_values_in_quotes_are_read_as_without(read):
    plain = f"{VUE}\n" + "\n".join(rows(stamps(50))) + "\n"
    quoted = "\n".join(",".join(f'"{v}"' for v in line.split(",")) for line in plain.split("\n"))
    a, b = read(plain), read(quoted.replace('"A69-1-7",""', '"A69-1-7","a ""b"", c"'))
    assert a.time.tolist() == b.time.tolist() and a.tag.tolist() == b.tag.tolist()
    assert set(b.extra["transmitter_name"]) == {'a "b", c'}
    held = read(f'{VUE}\n2021-06-01 10:00:00.5,VR2W-1,A-1,"two\nlines",\nx,,,,\n')
    assert held.extra["transmitter_name"][0].split() == ["two", "lines"]
    assert held.report.warnings[0].row == 4


def test_a_ping_of_a_mixed_array_is_one_tag(tmp_path):
    (tmp_path / "tbr.csv").write_text(
        "Date and Time (UTC),Unix Timestamp (UTC),ID,Data,Protocol,SNR,Receiver\n"
        "2021-06-01 12:00:00.005,1622548800.005,345,,R64K-69kHz,22,1234\n"
    )
    (tmp_path / "vue.csv").write_text(f"{VUE}\n2021-06-01 12:00:00.105,VR2W-1,A69-1303-345,,\n")
    d = read_detections(tmp_path / "tbr.csv", tmp_path / "vue.csv")
    assert d.tags == ("A69-1303-345",) and "two names of one tag" in str(d.report)
    alone = read_detections(tmp_path / "tbr.csv")
    assert alone.tags == ("R64K-345",) and alone.find_tag("A69-1303-345") == "R64K-345"


def test_depth_of_sensor_tags_reaches_the_pings(read):
    head = "Date and Time (UTC),Receiver,Transmitter,Sensor Value,Sensor Unit"
    body = [
        f"2021-06-01 10:00:{10 * i:02d}.{100 + 20 * j},VR2W-{j},A69-1-7,{2.5 + i},m"
        for i in range(3)
        for j in range(3)
    ]
    d = read("\n".join([head, *body]) + "\n")
    r = Receivers(np.array(["0", "1", "2"]), np.array([0.0, 100, 50]), np.array([0.0, 0, 90]))
    toa = toa_matrix(d, r, "A69-1-7", sound_speed=1500.0)
    assert toa.depth is not None and toa.depth.tolist() == [2.5, 3.5, 4.5]


def test_parquet_of_any_layout(tmp_path):
    df = pl.DataFrame(
        {"epo": [1622548800, 1622548801], "frac": [0.5, 0.25], "serial": [1, 2], "tag": [7, 7]}
    )
    df.write_parquet(tmp_path / "d.parquet")
    assert read_detections(tmp_path / "d.parquet").receivers == ("1", "2")
