"""Twelve files with names from public sources, written down before any of them was tried.

Every name stands in a public repository: a truck maker's fault snapshots, another one's service program, a J1939
decoder, a car's tester, Italian apps and an Italian logger, a ship's performance database, a Polish display, a
machine's leak data set, a phone app's log, a decoder of SAE J1979, a ship's log in Chinese. The values are the
simulated drive's; what a name stands for, its unit, and gauge or absolute are what its source says or its kind uses.
"""

from __future__ import annotations

from foreign import Foreign, file_of

UNSEEN: tuple[Foreign, ...] = (
    file_of("fault snapshots of a truck engine", """
        ECM_TIME | SECOND | time_s |
        ENGINE_SPEED | RPM | n_e_rpm |
        PERCENT_LOAD | PERCENT | torque % | %
        BAROMETRIC_AIR_PRESSURE | KPA | p_amb_pa | kPa
        OEM_AMBIENT_AIR_TEMPERATURE | DEG_C | t_amb_k | degC
        TURBOCHARGER_COMPRESSOR_INLET_AIR_TEMPERATURE | DEG_C | t inlet | degC
        TURBOCHARGER_COMPRESSOR_OUTLET_AIR_TEMPERATURE_CALCULATED | DEG_C | t cooler | degC
        ENGINE_COOLANT_TEMPERATURE | DEG_C | coolant | degC
        CRANKCASE_PRESSURE | KPA_G | p crankcase | kPa gauge
        EGR_TEMPERATURE | DEG_C | t egr | degC
        EGR_VALVE_POSITION_MEASURED_PERCENT_OPEN | PERCENT | u_egr_pct | %
        EGR_VALVE_POSITION_COMMANDED | PERCENT | egr wanted | %
        EGR_DIFFERENTIAL_PRESSURE | KPA | egr dp | kPa
        EXHAUST_GAS_PRESSURE | KPA | p_em_pa | kPa
        EXHAUST_GAS_TEMPERATURE_CALCULATED | DEG_C | t_em_k | degC
        FUEL_RAIL_PRESSURE_MEASURED | BAR_A | rail | bar
        INTAKE_MANIFOLD_PRESSURE | KPA_G | p_im_pa | kPa gauge
        INTAKE_MANIFOLD_AIR_TEMPERATURE | DEG_C | t_im_k | degC
        ENGINE_OIL_PRESSURE | KPA_G | oil pressure | kPa gauge
        ENGINE_OIL_TEMPERATURE | DEG_C | oil | degC
        VEHICLE_SPEED | KMPH | vehicle |
        AFTERTREATMENT_SCR_INTAKE_TEMPERATURE | DEG_C | t after | degC
        TURBOCHARGER_SPEED | KRPM | omega_t_rad_s | krpm of rad/s
        TURBOCHARGER_ACTUATOR_POSITION_MEASURED_PERCENT_CLOSED | PERCENT | u_vgt_pct | % shut
        TURBOCHARGER_ACTUATOR_POSITION_COMMANDED_PERCENT_CLOSED | PERCENT | vgt wanted | % shut""", row=True),
    file_of("a service program's identifiers", """
        time | s | time_s |
        DT_AS003_Actual_Torque | Nm | torque_nm |
        DT_AS010_Engine_Speed | 1/min | n_e_rpm |
        DT_AS012_Vehicle_Speed | km/h | vehicle |
        DT_AS013_Coolant_Temperature | °C | coolant | degC
        DT_AS014_Fuel_Temperature | °C | t fuel | degC
        DT_AS016_Oil_Temperature | °C | oil | degC
        DT_AS018_Inlet_Manifold_Pressure | mbar | p_im_pa | mbar
        DT_AS019_Barometric_Pressure | mbar | p_amb_pa | mbar
        DT_AS027_Turbo_Speed_1 | 1/min | omega_t_rad_s | rpm of rad/s
        DT_AS031_EGR_Commanded_Governor_Value | % | egr wanted | %
        DT_AS032_EGR_Actual_Valve_Position | % | u_egr_pct | %
        DT_AS034_Throttle_Valve_Actual_Position | % | pedal | %
        DT_AS043_Rail_Pressure | bar | rail | bar
        DT_AS056_Pressure_Compressor_Out | mbar | p compressor | mbar
        DT_AS058_Temperature_Compressor_Out | °C | t cooler | degC
        DT_AS087_Actual_Fuel_Mass | mg | u_delta_mg |
        DT_AS098_desired_rail_pressure | bar | rail | bar
        DT_AS117_Percentage_of_current_VGT_position | % | u_vgt_pct | %
        DT_AS005_DOC_Inlet_Pressure | mbar | p after | mbar""", row=True),
    file_of("short names of a J1939 decoder", """
        Timestamp | s | time_s |
        EngSpeed | rpm | n_e_rpm |
        ActualEngPercentTorque | % | torque % | %
        EngPercentLoadAtCurrentSpeed | % | pedal | %
        AccelPedalPos1 | % | pedal | %
        EngFuelRate | L/h | fuel | L/h
        EngIntakeManifold1Press | kPa | p_im_pa | kPa gauge
        EngIntakeManifold1Temp | deg C | t_im_k | degC
        CmdedEngIntakeManifoldPress | kPa | boost wanted | kPa
        EngExhstGsRcirculation1ValvePos | % | u_egr_pct | %
        EngExhstGsRcrculation1DiffPress | kPa | egr dp | kPa
        EngExhaustGasRecirculation1Temp | deg C | t egr | degC
        EngExhaustGasTemp | deg C | t_em_k | degC
        EngAirFilter1DiffPress | kPa | filter dp | kPa
        EngCrankcasePress | kPa | p crankcase | kPa gauge
        EngOilPress | kPa | oil pressure | kPa gauge
        EngOilTemp1 | deg C | oil | degC
        EngTurboOilTemp | deg C | oil | degC
        EngIntercoolerTemp | deg C | coolant | degC
        EngCoolantTemp | deg C | coolant | degC
        EngFuelTemp1 | deg C | t fuel | degC""", row=True),
    file_of("the log of a car's tester", """
        Time | s | time_s |
        EngineRpm | rpm | n_e_rpm |
        VehicleSpeed | km/h | vehicle |
        CoolantTemperature | °C | coolant | degC
        ExternalTemperature | °C | t_amb_k | degC
        InletTemperature | °C | t_im_k | degC
        FuelTemperature | °C | t fuel | degC
        AcceleratorTrack1 | % | pedal | %
        AmbientPressure | kPa | p_amb_pa | kPa
        ManifoldAirPressure | kPa | p_im_pa | kPa
        ManifoldAirFlow | kg/h | w_c_kg_s | kg/h
        DriverDemand | mg/str | fuel wanted |
        TorqueLimit | mg/str | fuel limit |
        SmokeLimit | mg/str | fuel limit |
        InjectionQuantity | mg/str | u_delta_mg |
        AfRatio | - | afr |""", row=True),
    file_of("an Italian app's labels", """
        Tempo | s | time_s |
        Carico Motore | % | torque % | %
        Temp. Liquido Raffred. | °C | coolant | degC
        Pressione Turbo/MAP | kPa | p_im_pa | kPa
        Giri Motore (RPM) | rpm | n_e_rpm |
        Velocità Veicolo | km/h | vehicle |
        Temp. Aria Aspirata | °C | t_im_k | degC
        MAF (Flusso Aria) | g/s | w_c_kg_s | g/s
        Posizione Farfalla | % | pedal | %
        Temp. Olio Motore | °C | oil | degC
        Pressione Barometrica | kPa | p_amb_pa | kPa
        Temperatura esterna | °C | t_amb_k | degC
        Temperatura gas di scarico | °C | t_em_k | degC
        Temperatura DPF | °C | t after | degC""", row=True),
    file_of("an Italian logger with little room", """
        tempo | s | time_s |
        Giri | rpm | n_e_rpm |
        Cil 1 | °C | t cylinder | degC
        Cil 2 | °C | t cylinder | degC
        IC in | °C | t cooler | degC
        IC out | °C | t_im_k | degC
        Olio | °C | oil | degC
        Acqua | °C | coolant | degC
        P IC in | bar | p compressor | bar gauge
        P IC out | bar | p_im_pa | bar gauge
        P scar | bar | p_em_pa | bar gauge
        P benz | bar | rail | bar
        P olio | bar | oil pressure | bar gauge""", row=True),
    file_of("short keys of a ship's performance database", """
        time | s | time_s |
        ensp | rpm | n_e_rpm |
        tcspeed | rpm | omega_t_rad_s | rpm of rad/s
        tTurbIn | deg C | t_em_k | degC
        tTurbO | deg C | t after | degC
        pscav | bar | p_im_pa | bar gauge
        tscav | deg C | t_im_k | degC
        pexh | bar | p_em_pa | bar gauge
        airAcIn | deg C | t cooler | degC
        pdac | mbar | filter dp | mbar
        fcon | kg/h | fuel | kg/h
        flowComp | kg/s | w_c_kg_s | kg/s
        compPresOut | bar | p compressor | bar gauge
        JCWOut | deg C | coolant | degC
        backT | mbar | p after | mbar gauge
        afPd | mbar | filter dp | mbar
        pAmb | bar | p_amb_pa | bar
        fTemp | deg C | t fuel | degC""", row=True),
    file_of("a Polish display", """
        Czas | s | time_s |
        Obroty silnika (RPM) | obr/min | n_e_rpm |
        Temperatura cieczy chłodzącej | °C | coolant | degC
        Temperatura w przepływomierzu | °C | t inlet | degC
        Przepływ powietrza (MAF) | g/s | w_c_kg_s | g/s
        Ciśnienie doładowania (Turbo) | bar | p_im_pa | bar
        Ciśnienie paliwa | bar | rail | bar
        Temperatura paliwa | °C | t fuel | degC
        Temperatura powietrza doładowanego (intercooler) | °C | t_im_k | degC""", row=True),
    file_of("a data set of leaks of a machine's engine", """
        TimeStep | s | time_s |
        RPM | rpm | n_e_rpm |
        Fuel_Rate | L/h | fuel | L/h
        Fuel_Injection_Pressure | MPa | rail | MPa
        Filter_DeltaP | kPa | filter dp | kPa
        Turbo_Inlet_Pressure | kPa | p inlet | kPa
        Turbo_Speed | rpm | omega_t_rad_s | rpm of rad/s
        Compressor_Outlet_Pressure | kPa | p compressor | kPa
        Compressor_Outlet_Temperature | °C | t cooler | degC
        MAP | kPa | p_im_pa | kPa
        MAT | °C | t_im_k | degC
        Turbine_Inlet_Pressure | kPa | p_em_pa | kPa
        DOC_Inlet_EGT | °C | t after | degC
        DOC_Outlet_EGT | °C | t after | degC
        DPF_DeltaP | kPa | filter dp | kPa
        DPF_EGT | °C | t after | degC""", row=True),
    file_of("the log of a phone app, units in the names", """
        Time(s) | | time_s |
        Engine RPM(rpm) | | n_e_rpm |
        Speed (OBD)(km/h) | | vehicle |
        Engine Load(%) | | torque % | %
        Absolute Throttle Position B(%) | | pedal | %
        Accelerator PedalPosition D(%) | | pedal | %
        Mass Air Flow Rate(g/s) | | w_c_kg_s | g/s
        Intake Manifold Pressure(psi) | | p_im_pa | psi
        Boost Pressure Commanded A(psi) | | boost wanted | psi
        Barometric pressure (from vehicle)(psi) | | p_amb_pa | psi
        Ambient air temp(°C) | | t_amb_k | degC
        Intake Air Temperature(°F) | | t_im_k | degF
        Engine Coolant Temperature(°F) | | coolant | degF
        Engine Oil Temperature(°F) | | oil | degF
        EGR Commanded(%) | | u_egr_pct | %
        EGR Error(%) | | error | %
        Fuel flow rate/hour(l/hr) | | fuel | L/h
        Fuel Rail Pressure(psi) | | rail | psi
        Catalyst Temperature (Bank 1 Sensor 1)(°C) | | t after | degC
        Volumetric Efficiency (Calculated)(%) | | torque % | %
        Drivers demand engine % torque(%) | | torque % | %"""),
    file_of("keys of a decoder of SAE J1979", """
        time | s | time_s |
        Engine speed | rpm | n_e_rpm |
        Vehicle speed | km/h | vehicle |
        Intake manifold absolute pressure | kPa | p_im_pa | kPa
        MAF air flow rate | g/s | w_c_kg_s | g/s
        Absolute barometric pressure | kPa | p_amb_pa | kPa
        Ambient air temperature | °C | t_amb_k | degC
        Intake air temperature | °C | t_im_k | degC
        Engine oil temperature | °C | oil | degC
        commanded_boost_a | kPa | boost wanted | kPa
        commanded_vgt_a | % | vgt wanted | %
        vgt_position_a | % | u_vgt_pct | %
        Commanded EGR | % | u_egr_pct | %
        EGR error | % | error | %
        compressor_inlet | °C | t inlet | degC
        compressor_outlet | °C | t cooler | degC
        turbine_inlet | °C | t_em_k | degC
        turbine_outlet | °C | t after | degC
        Fuel rail absolute pressure | kPa | rail | kPa
        Relative throttle position | % | pedal | %""", row=True),
    file_of("a ship's log in Chinese", """
        采样时间 | s | time_s |
        轴转速 | r/min | n_e_rpm |
        主机扫气压力 | bar | p_im_pa | bar gauge
        主机扫气箱温度 | °C | t_im_k | degC
        主机1号涡轮增压器转速 | r/min | omega_t_rad_s | rpm of rad/s
        主机1号涡轮增压器废气进口温度 | °C | t_em_k | degC
        主机1号涡轮增压器废气出口温度 | °C | t after | degC
        主机1号气缸排气温度 | °C | t cylinder | degC
        主机燃油进机温度 | °C | t fuel | degC
        冷却海水温度 | °C | t inlet | degC
        主机燃油流量 | kg/h | fuel | kg/h""", row=True),
)  # fmt: skip
"""Judged once, before anything was mended on them; the figures stand in docs/formats.md."""
