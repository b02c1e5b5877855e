"""Decodes a 64-bit NAME into words: manufacturer, function, device class, industry group.

Facts of SAE J1939-81 and ISO 11783-1 as AgIsoStack (can_NAME.hpp) and canboat (database/lookups) list them;
of J1939's manufacturers those met on farms. NMEA 2000 numbers manufacturers, classes and functions in its own
way: its devices are those of the industry group "marine".
"""

from collections.abc import Mapping
from typing import Final

from tilth.schemas.pgn_table import MARINE, row

AGRICULTURE: Final = 2

# fmt: off
INDUSTRY_GROUPS: Final[Mapping[int, str]] = {
    0: "global", 1: "on-highway", 2: "agriculture and forestry", 3: "construction", 4: "marine",
    5: "industrial",
}
MANUFACTURERS: Final[Mapping[int, str]] = {
    1: "Bendix", 2: "Allison Transmission", 7: "Case", 8: "Caterpillar", 10: "Cummins",
    12: "Deere Precision Farming", 14: "Detroit Diesel", 15: "DICKEY-john", 16: "Eaton", 33: "John Deere",
    50: "Bosch", 51: "Bosch", 57: "Danfoss", 61: "Volvo Truck", 62: "Wabco", 63: "ZF", 65: "MAN",
    66: "John Deere Construction", 67: "John Deere Coffeyville", 68: "Scania", 69: "Trimble",
    70: "Flexi-Coil", 71: "Vansco", 72: "Sisu", 75: "Deere Agricultural Division",
    77: "Deere Power Systems", 80: "Twin Disc", 84: "New Holland", 87: "JCB", 88: "Hemisphere",
    89: "Kverneland", 92: "Ag-Chem", 93: "Perkins", 94: "CNH", 97: "Ag Leader",
    98: "PTx Trimble (Mueller-Elektronik)", 102: "AGCO", 103: "CLAAS E-Systems", 104: "CLAAS",
    107: "Grimme", 108: "PTx Trimble (WTK)", 109: "TeeJet Denmark", 111: "Krone", 116: "Beeline",
    117: "HUSCO", 120: "RDS", 121: "HED", 124: "Hydac", 135: "Airmar", 136: "Komatsu", 137: "Maretron",
    138: "Fritzmeier", 139: "Caterpillar Trimble", 142: "TRW Steering", 151: "Raven", 152: "elobau",
    153: "Woodward", 162: "Axiomatic", 164: "MTU", 166: "John Deere Electronic Solutions",
    171: "Topcon (Wachendorff)", 172: "Yanmar", 179: "TeeJet Springfield", 196: "LEMKEN", 199: "Actia",
    207: "Otto", 213: "CNH Belgium", 214: "MC elettronica", 217: "RM Michaelides", 229: "Garmin",
    231: "Topcon", 236: "NORAC", 238: "ZF Friedrichshafen", 245: "Capstan Ag", 250: "Kuhn", 251: "DLG",
    252: "Sensor-Technik Wiedemann", 258: "ARAG", 259: "Bucher Automation (Jetter)", 260: "Reichhardt",
    280: "Leica Geosystems", 290: "Kuebler", 299: "Rauch", 305: "NovAtel", 337: "Carraro",
    339: "Competence Center ISOBUS", 343: "Baumer", 348: "Amazone", 352: "SAME Deutz-Fahr", 357: "Hardi",
    362: "Poettinger", 365: "Digi-Star", 377: "ifm electronic", 382: "NARO", 399: "ISEKI", 410: "COBO",
    416: "Kubota", 420: "Vermeer", 436: "Kinze", 441: "PTG Reifendruckregelsysteme", 442: "HORSCH",
    447: "Great Plains", 449: "Polaris", 467: "Lely", 489: "Appareo", 500: "Oxbo",
    507: "ISOBUS Test Center", 511: "Sulky", 514: "DISTek", 522: "Nebraska Tractor Test Laboratory",
    527: "GKN Walterscheid", 542: "Dinamica Generale", 560: "Iowa State University",
    569: "LORD MicroStrain", 572: "Fasse", 581: "Väderstad", 587: "JCA Electronics",
    629: "Agri Info Design", 632: "Pepperl+Fuchs", 635: "Argo Tractors", 643: "Bogballe", 668: "MacDon",
    674: "Yara", 685: "ANEDO", 690: "LINAK", 717: "Yacht Devices", 729: "Liebherr", 746: "SurePoint Ag",
    750: "Joskin", 756: "Maschio Gaspardo", 764: "Bednar", 766: "Epec", 809: "HMS", 816: "UniStrong",
    818: "HGNSS", 823: "ACEINNA", 841: "Agra-GPS", 850: "Geoprospectors", 854: "GEMAC",
    883: "Swift Navigation", 885: "SICK", 906: "MOBA", 914: "ZETOR", 934: "Farmobile", 942: "Vogelsang",
    1023: "PEAK-System", 1035: "Agres", 1046: "Praxidyn", 1061: "Volvo Construction Equipment",
    1856: "Trimble",
}
_MARINE_MANUFACTURERS: Final[Mapping[int, str]] = {
    69: "ARKS Enterprises", 78: "FW Murphy/Enovation Controls", 80: "Twin Disc", 85: "Kohler Power Systems",
    88: "Hemisphere", 135: "Airmar", 137: "Maretron", 140: "Lowrance", 144: "Mercury Marine",
    147: "Nautibus Electronic", 148: "Blue Water Data", 154: "Westerbeke", 157: "ISSPRO",
    161: "Offshore Systems", 163: "Evinrude/BRP", 165: "CPAC Systems", 168: "Xantrex Technology",
    169: "Marlin Technologies", 172: "Yanmar Marine", 174: "Volvo Penta", 176: "Carling Technologies",
    185: "Beede Instruments", 192: "Floscan Instrument", 193: "Nobeltec",
    198: "Mystic Valley Communications", 199: "Actia", 201: "Disenos Y Technologia",
    211: "Digital Switching Systems", 215: "Xintex/Atena", 224: "EMMI NETWORK", 228: "ZF", 229: "Garmin",
    233: "Yacht Monitoring Solutions", 235: "Sailormade Marine Telemetry/Tetra Technology", 243: "Eride",
    257: "Honda Motor", 272: "Groco", 273: "Actisense", 274: "Amphenol LTW Technology", 275: "Navico",
    283: "Hamilton Jet", 285: "Sea Recovery", 286: "Coelmo", 295: "BEP Marine", 304: "Empir Bus",
    305: "NovAtel", 306: "Sleipner Motor", 307: "MBW Technologies", 315: "ICOM", 328: "Qwerty", 329: "Dief",
    341: "Boening Automationstechnologie", 345: "Korean Maritime University", 351: "Thrane and Thrane",
    355: "Mastervolt", 356: "Fischer Panda Generators", 358: "Victron Energy", 370: "Rolls Royce Marine",
    373: "Electronic Design", 374: "Northern Lights", 378: "Glendinning", 381: "B & G",
    384: "Rose Point Navigation Systems", 385: "Johnson Outdoors Marine Electronics Inc Geonav",
    394: "Capi 2", 396: "Beyond Measure", 400: "Livorsi Marine", 404: "ComNav", 409: "Chetco",
    419: "Fusion Electronics", 421: "Standard Horizon", 422: "True Heading",
    426: "Egersund Marine Electronics", 427: "em-trak Marine Electronics", 431: "Tohatsu",
    437: "Digital Yacht", 438: "Comar Systems", 440: "Cummins", 443: "VDO", 451: "Parker Hannifin",
    459: "Alltek Marine Electronics", 460: "SAN GIORGIO S.E.I.N", 466: "Veethree Electronics & Marine",
    470: "SI-TEX Marine Electronics", 471: "Sea Cross Marine", 475: "GME",
    476: "Humminbird Marine Electronics", 478: "Ocean Sat", 481: "Chetco Digital Instruments",
    493: "Watcheye", 499: "Lcj Capteurs", 502: "Attwood Marine", 503: "Naviop S.R.L.", 504: "Vesper Marine",
    510: "Marinesoft", 513: "Simarine", 517: "NoLand Engineering", 518: "Transas USA",
    529: "National Instruments Korea", 530: "National Marine Electronics Association", 532: "Onwa Marine",
    540: "Webasto", 571: "Marinecraft", 573: "McMurdo Group", 578: "Advansea", 579: "KVH",
    580: "San Jose Technology", 583: "Yacht Control", 586: "Suzuki Motor", 591: "US Coast Guard",
    595: "Ship Module", 600: "Aquatic AV", 605: "Aventics", 606: "Intellian", 612: "SamwonIT",
    614: "Arlt Tecnologies", 637: "Bavaria Yachts", 641: "Diverse Yacht Services",
    644: "Wema U.S.A dba KUS", 658: "Shenzhen Jiuzhou Himunication", 688: "Rockford",
    699: "Harman International", 704: "JL Audio", 708: "Lars Thrane", 715: "Autonnic", 717: "Yacht Devices",
    734: "REAP Systems", 735: "AEM Performance Electronics", 739: "LxNav", 741: "Littelfuse",
    743: "DaeMyung", 744: "Woosung", 748: "ISOTTA IFRA srl", 773: "Clarion US", 776: "HMI Systems",
    777: "Ocean Signal", 778: "Seakeeper", 781: "Poly Planar", 785: "Fischer Panda DE",
    795: "Broyda Industries", 796: "Canadian Automotive", 797: "Tides Marine", 798: "Lumishore",
    799: "Still Water Designs and Audio", 802: "BJ Technologies", 803: "Gill Sensors",
    811: "Blue Water Desalination", 815: "FLIR", 824: "Undheim Systems", 826: "Lewmar", 838: "TeamSurv",
    844: "Fell Marine", 847: "Oceanvolt", 862: "Prospec", 868: "Data Panel", 890: "L3 Technologies",
    894: "Rhodan Marine Systems", 896: "Nexfour Solutions", 905: "ASA Electronics", 909: "Marines",
    911: "Nautic-on", 917: "Sentinel", 929: "JL Marine Systems", 930: "Ecotronix", 944: "Zontisa Marine",
    951: "EXOR International", 962: "Timbolier Industries", 963: "TJC Micro", 968: "Cox Powertrain",
    969: "Blue Seas", 981: "Kobelt Manufacturing", 992: "Blue Ocean IOT", 997: "Xenta Systems",
    999: "Signal K", 1004: "Ultraflex", 1008: "Lintest SmartBoat", 1011: "Soundmax",
    1020: "Team Italia Marine", 1021: "Entratech", 1022: "ITC", 1029: "The Marine Guardian", 1047: "Sonic",
    1051: "ProNav", 1053: "Vetus Maxwell", 1056: "Lithium Pros", 1059: "Boatrax", 1062: "Marol",
    1065: "CALYPSO Instruments", 1066: "Spot Zero Water", 1069: "Lithionics Battery",
    1070: "Quick-teck Electronics", 1075: "Uniden America", 1083: "Nauticoncept",
    1084: "Shadow-Caster LED lighting", 1085: "Wet Sounds", 1088: "E-T-A Circuit Breakers",
    1092: "Scheiber", 1100: "Smart Yachts International", 1109: "Dockmate", 1114: "Bobs Machine",
    1118: "L3Harris ASV", 1119: "Balmar", 1120: "Elettromedia", 1127: "Electromaax",
    1140: "Across Oceans Systems", 1145: "Kiwi Yachting", 1150: "BSB Artificial Intelligence",
    1151: "Orca Technologies", 1154: "TBS Electronics", 1158: "Technoton Electroics",
    1160: "MG Energy Systems", 1169: "Sea Machine Robotics", 1171: "Vista Manufacturing", 1183: "Zipwake",
    1186: "Sailmon", 1192: "Airmoniq Pro Kft", 1194: "Sierra Marine", 1200: "Xinuo Information Technology",
    1218: "Septentrio", 1233: "NKE Marine Electronics", 1238: "SuperTrack Aps", 1239: "Honda Electronics",
    1245: "Raritan Engineering", 1249: "Integrated Power Solutions", 1260: "Interactive Technologies",
    1283: "LTG-Tech", 1299: "Energy Solutions", 1300: "WATT Fuel Cell", 1302: "Pro Mainer",
    1305: "Dragonfly Energy", 1306: "Koden Electronics", 1311: "Humphree", 1316: "Hinkley Yachts",
    1317: "Global Marine Management", 1320: "Triskel Marine", 1330: "Warwick Control Technologies",
    1331: "Dolphin Charger", 1337: "Barnacle Systems", 1348: "Radian IoT", 1353: "Ocean LED Marine",
    1359: "BluNav", 1361: "OVA", 1368: "RAD Propulsion", 1369: "Electric Yacht", 1372: "Elco Motor Yachts",
    1384: "Tecnoseal Foundry", 1385: "Pro Charging Systems", 1389: "EVEX", 1398: "Gobius Sensor Technology",
    1403: "Arco Marine", 1408: "Lenco Marine", 1413: "Naocontrol", 1417: "Revatek", 1438: "Aeolionics",
    1439: "PredictWind", 1440: "Egis Mobile Electric", 1445: "Starboard Yacht Group",
    1446: "Roswell Marine", 1451: "ePropulsion", 1452: "Micro-Air", 1453: "Vital Battery",
    1458: "Ride Controller", 1460: "Tocaro Blue", 1461: "Vanquish Yachts", 1471: "FT Technologies",
    1478: "Alps Alpine", 1481: "E-Force Marine", 1482: "CMC Marine",
    1483: "Nanjing Sandemarine Information Technology", 1850: "Teleflex Marine", 1851: "Raymarine",
    1852: "Navionics", 1853: "Japan Radio", 1854: "Northstar Technologies", 1855: "Furuno", 1856: "Trimble",
    1857: "Simrad", 1858: "Litton", 1859: "Kvasar", 1860: "MMP", 1861: "Vector Cantech",
    1862: "Yamaha Marine", 1863: "Faria Instruments",
}
# 0 to 127 mean the same in every industry group but the marine one.
FUNCTIONS: Final[Mapping[int, str]] = {
    0: "engine", 1: "auxiliary power unit", 2: "electric propulsion", 3: "transmission",
    4: "battery pack monitor", 5: "shift control", 6: "rear PTO", 7: "steering axle", 8: "driving axle",
    9: "brakes", 10: "steer axle brakes", 11: "drive axle brakes", 12: "engine retarder",
    13: "driveline retarder", 14: "cruise control", 15: "fuel system", 16: "steering controller",
    17: "steer axle suspension", 18: "drive axle suspension", 19: "instrument cluster", 20: "trip recorder",
    21: "cab climate control", 22: "aerodynamic control", 23: "navigation", 24: "vehicle security",
    25: "network interconnect", 26: "body controller", 27: "front PTO", 28: "off-vehicle gateway",
    29: "virtual terminal", 30: "management computer", 31: "propulsion battery charger",
    32: "headway control", 33: "system monitor", 34: "hydraulic pump control", 35: "suspension",
    36: "pneumatics", 37: "cab controller", 38: "tire pressure control", 39: "ignition control",
    40: "seat control", 41: "lighting controls", 42: "water pump control", 43: "transmission display",
    44: "exhaust emission control", 45: "stability control", 46: "oil monitor", 47: "information system",
    48: "ramp control", 49: "clutch or converter", 50: "auxiliary heater", 51: "collision warning",
    52: "chassis control", 53: "alternator", 54: "cellular radio", 55: "satellite radio", 56: "radio",
    57: "steering column controls", 58: "fan drive", 59: "starter", 60: "cab display",
    61: "file server or printer", 62: "diagnostic unit", 63: "engine valve control",
    64: "endurance braking", 65: "gas flow measurement", 66: "I/O controller", 67: "electrical system",
    68: "aftertreatment gas measurement", 69: "aftertreatment", 70: "auxiliary regeneration",
    71: "transfer case", 72: "coolant valve", 73: "rollover detection", 74: "lubrication",
    75: "supplemental fan", 76: "temperature sensor", 77: "fuel properties sensor", 78: "fire suppression",
    79: "power manager", 80: "electric powertrain", 81: "hydraulic powertrain", 82: "file server",
    83: "printer", 84: "start aid", 85: "injection control", 86: "EV charging communication",
    87: "driver impairment device", 88: "electric power converter",
}
_FARM_FUNCTIONS: Final[Mapping[tuple[int, int], str]] = {
    (0, 128): "display (no virtual terminal)", (0, 129): "operator controls", (0, 130): "task controller",
    (0, 133): "foreign object detection", (0, 134): "tractor ECU", (0, 135): "sequence control master",
    (0, 136): "product dosing", (0, 137): "product treatment", (0, 139): "data logger",
    (0, 140): "decision support", (0, 141): "lighting controller", (0, 142): "TIM server",
    (1, 129): "auxiliary valve control", (1, 130): "rear hitch control", (1, 131): "front hitch control",
    (1, 134): "center hitch control", (4, 137): "down pressure", (5, 130): "product pressure",
    (7, 128): "tailing monitor", (7, 129): "header control", (7, 130): "product loss monitor",
    (7, 131): "product moisture", (9, 128): "twine or wrapper control", (9, 129): "packaging control",
    (9, 131): "product moisture", (11, 136): "unload control", (17, 128): "guidance feeler",
    (17, 129): "camera", (17, 130): "crop scouting", (17, 131): "material properties",
    (17, 132): "inertial measurement unit", (17, 135): "product mass", (17, 136): "vibration",
    (17, 137): "weather instruments", (17, 138): "soil scouting",
}
_IMPLEMENT_FUNCTIONS: Final[Mapping[int, str]] = {
    128: "rate control", 129: "section control", 131: "position control", 132: "machine control",
    133: "product flow", 134: "product level", 135: "depth or height control", 136: "frame control",
}
_MARINE_FUNCTIONS: Final[Mapping[tuple[int, int], str]] = {
    (10, 130): "diagnostic", (10, 140): "bus traffic logger", (20, 110): "alarm enunciator",
    (20, 130): "EPIRB", (20, 135): "man overboard", (20, 140): "voyage data recorder", (20, 150): "camera",
    (25, 130): "PC gateway", (25, 131): "NMEA 2000 to analog gateway",
    (25, 132): "analog to NMEA 2000 gateway", (25, 133): "NMEA 2000 to serial gateway",
    (25, 135): "NMEA 0183 gateway", (25, 136): "NMEA network gateway",
    (25, 137): "NMEA 2000 wireless gateway", (25, 140): "router", (25, 150): "bridge",
    (25, 160): "repeater", (30, 130): "binary event monitor", (30, 140): "load controller",
    (30, 141): "AC/DC input", (30, 150): "function controller", (35, 140): "engine",
    (35, 141): "DC generator", (35, 142): "solar panel", (35, 143): "wind generator",
    (35, 144): "fuel cell", (35, 145): "network power supply", (35, 151): "AC generator",
    (35, 152): "AC bus", (35, 153): "AC mains", (35, 154): "AC output", (35, 160): "battery charger",
    (35, 161): "battery charger and inverter", (35, 162): "inverter", (35, 163): "DC converter",
    (35, 170): "battery", (35, 180): "engine gateway", (40, 130): "follow-up controller",
    (40, 140): "mode controller", (40, 150): "autopilot", (40, 155): "rudder", (40, 160): "heading sensor",
    (40, 170): "trim tabs", (40, 180): "attitude control", (50, 130): "engine room monitoring",
    (50, 140): "engine", (50, 141): "DC generator", (50, 150): "engine controller",
    (50, 151): "AC generator", (50, 155): "motor", (50, 160): "engine gateway", (50, 165): "transmission",
    (50, 170): "throttle or shift control", (50, 180): "actuator", (50, 190): "gauge interface",
    (50, 200): "large gauge", (50, 210): "small gauge", (60, 130): "bottom depth",
    (60, 135): "bottom depth and speed", (60, 136): "bottom depth, speed, temperature",
    (60, 140): "ownship attitude", (60, 145): "ownship position (GNSS)",
    (60, 150): "ownship position (Loran C)", (60, 155): "speed", (60, 160): "turn rate indicator",
    (60, 170): "integrated navigation", (60, 175): "integrated navigation system",
    (60, 190): "navigation management", (60, 195): "AIS", (60, 200): "radar", (60, 201): "infrared imaging",
    (60, 205): "ECDIS", (60, 210): "ECS", (60, 220): "direction finder", (60, 230): "voyage status",
    (70, 130): "EPIRB", (70, 140): "AIS", (70, 150): "DSC", (70, 160): "data receiver",
    (70, 170): "satellite", (70, 180): "radiotelephone (MF/HF)", (70, 190): "radiotelephone",
    (75, 130): "temperature", (75, 140): "pressure", (75, 150): "fluid level", (75, 160): "flow",
    (75, 170): "humidity", (80, 130): "time and date", (80, 140): "voyage data recorder",
    (80, 150): "integrated instrumentation", (80, 160): "general purpose display",
    (80, 170): "general sensor box", (80, 180): "weather instruments", (80, 190): "transducer",
    (80, 200): "NMEA 0183 converter", (85, 130): "atmospheric", (85, 160): "aquatic", (90, 130): "HVAC",
    (100, 130): "scale (catch)", (110, 130): "button interface", (110, 135): "switch interface",
    (110, 140): "analog interface", (120, 130): "display", (120, 140): "alarm enunciator",
    (125, 130): "multimedia player", (125, 140): "multimedia controller",
}
_FARM_CLASSES: Final[Mapping[int, str]] = {
    0: "non-specific", 1: "tractor", 2: "tillage", 3: "secondary tillage", 4: "planter or seeder",
    5: "fertilizer", 6: "sprayer", 7: "harvester", 8: "root harvester", 9: "forage", 10: "irrigation",
    11: "transport or trailer", 12: "farmyard", 13: "powered auxiliary", 14: "special crop",
    15: "earthwork", 16: "skidder", 17: "sensor system", 19: "timber harvester", 20: "forwarder",
    21: "timber loader", 22: "timber processor", 23: "mulcher", 24: "utility vehicle",
    25: "slurry applicator", 26: "feeder or mixer", 27: "weeder", 28: "mower",
}
_MARINE_CLASSES: Final[Mapping[int, str]] = {
    0: "reserved", 10: "system tools", 20: "safety systems", 25: "internetwork device",
    30: "electrical distribution", 35: "electrical generation", 40: "steering and control surfaces",
    50: "propulsion", 60: "navigation", 70: "communication", 75: "sensor communication interface",
    80: "instrumentation", 85: "external environment", 90: "internal environment",
    100: "deck, cargo, fishing", 110: "human interface", 120: "display", 125: "entertainment",
}
# fmt: on


def manufacturer_name(code: int, industry_group: int | None = None) -> str:
    """Name of a manufacturer; "" where unknown."""
    first, second = MANUFACTURERS, _MARINE_MANUFACTURERS
    if industry_group == MARINE:
        first, second = second, first
    return first.get(code) or second.get(code, "")


def function_name(code: int, device_class: int, industry_group: int) -> str:
    """Function of a device; "" where unknown."""
    if industry_group == MARINE:
        return _MARINE_FUNCTIONS.get((device_class, code), "")
    if code < 128:
        return FUNCTIONS.get(code, "")
    if industry_group != AGRICULTURE:
        return ""
    function = _FARM_FUNCTIONS.get((device_class, code), "")
    return function or (_IMPLEMENT_FUNCTIONS.get(code, "") if 2 <= device_class <= 15 else "")


def class_name(device_class: int, industry_group: int) -> str:
    """Kind of machine that a device belongs to; "" where unknown."""
    classes = {AGRICULTURE: _FARM_CLASSES, MARINE: _MARINE_CLASSES}.get(industry_group, {})
    return classes.get(device_class, "")


def name_parts(name: int) -> dict[str, int]:
    """The numbers in a NAME, by the keys of PGN 60928."""
    return {key: int(value) for key, value in row(60928).layout.fields(name.to_bytes(8, "little")).items()}


def name_words(name: int) -> dict[str, str]:
    """Its codes in words, by key + "_name"; absent where one is not known here."""
    parts = name_parts(name)
    kind, group = parts["device_class"], parts["industry_group"]
    names = {
        "manufacturer_name": manufacturer_name(parts["manufacturer"], group),
        "function_name": function_name(parts["function"], kind, group),
        "device_class_name": class_name(kind, group),
        "industry_group_name": INDUSTRY_GROUPS.get(group, ""),
    }
    return {key: word for key, word in names.items() if word}


def of_implement(name: int) -> bool:
    """Whether a NAME is of a machine that is pulled or carried, by its device class of ISO 11783."""
    parts = name_parts(name)
    kind = parts["device_class"]
    return parts["industry_group"] == AGRICULTURE and (2 <= kind <= 15 or 25 <= kind <= 28)


def device(name: int) -> str:
    """Manufacturer and function of a NAME, for people, such as "John Deere, navigation, instance 1"."""
    parts, words = name_parts(name), name_words(name)
    parts_in_words = [
        words.get("manufacturer_name", f"manufacturer {parts['manufacturer']}"),
        words.get("function_name", f"function {parts['function']}"),
    ]
    if parts["industry_group"] == AGRICULTURE and parts["device_class"] > 1:
        parts_in_words.append(words.get("device_class_name", f"class {parts['device_class']}"))
    instance = parts["function_instance"] or parts["device_instance"]
    return ", ".join([*parts_in_words, f"instance {instance}"] if instance else parts_in_words)
